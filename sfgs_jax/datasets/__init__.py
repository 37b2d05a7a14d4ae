"""Readers that turn recordings into frames."""

from sfgs_jax.datasets.association import associate as associate
from sfgs_jax.datasets.opening import LAYOUTS as LAYOUTS
from sfgs_jax.datasets.opening import open_recording as open_recording
from sfgs_jax.datasets.options import ReaderOptions as ReaderOptions
from sfgs_jax.datasets.prefetch import prefetch as prefetch
from sfgs_jax.datasets.recording import Recording as Recording
from sfgs_jax.datasets.selection import Selection as Selection
from sfgs_jax.datasets.synthetic import SyntheticRoom as SyntheticRoom
from sfgs_jax.datasets.writers import write_recording as write_recording
