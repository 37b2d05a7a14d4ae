"""The built-in synthetic room."""

from sfgs_jax.datasets.synthetic.room import SyntheticRoom as SyntheticRoom
