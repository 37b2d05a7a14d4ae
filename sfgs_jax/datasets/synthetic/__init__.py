"""Built-in synthetic recordings."""

from sfgs_jax.datasets.synthetic.recording import SyntheticRecording as SyntheticRecording
