"""Readers that turn recordings into frames, and image sets into pairs and photographs."""

from sfgs_jax.datasets.association import associate as associate
from sfgs_jax.datasets.hpatches import HPATCHES_LARGE as HPATCHES_LARGE
from sfgs_jax.datasets.hpatches import read_hpatches as read_hpatches
from sfgs_jax.datasets.image_pairs import HomographyPair as HomographyPair
from sfgs_jax.datasets.image_pairs import PosePair as PosePair
from sfgs_jax.datasets.live import play as play
from sfgs_jax.datasets.opening import LAYOUTS as LAYOUTS
from sfgs_jax.datasets.opening import open_recording as open_recording
from sfgs_jax.datasets.options import ReaderOptions as ReaderOptions
from sfgs_jax.datasets.photos import PHOTO_LAYOUTS as PHOTO_LAYOUTS
from sfgs_jax.datasets.photos import Photos as Photos
from sfgs_jax.datasets.photos import read_photos as read_photos
from sfgs_jax.datasets.pose_pairs import read_megadepth_1500 as read_megadepth_1500
from sfgs_jax.datasets.pose_pairs import read_pair_list as read_pair_list
from sfgs_jax.datasets.pose_pairs import read_scannet_1500 as read_scannet_1500
from sfgs_jax.datasets.prefetch import prefetch as prefetch
from sfgs_jax.datasets.recording import Recording as Recording
from sfgs_jax.datasets.recording_pairs import RecordingPair as RecordingPair
from sfgs_jax.datasets.recording_pairs import recording_pairs as recording_pairs
from sfgs_jax.datasets.selection import Selection as Selection
from sfgs_jax.datasets.synthetic import SyntheticRecording as SyntheticRecording
from sfgs_jax.datasets.writers import write_recording as write_recording
