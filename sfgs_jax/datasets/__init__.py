"""Recordings as frames, and image sets as pairs and photographs.

The package `layouts` holds one reader a layout, and `files` the functions that readers are built from. The
sets that keypoints are judged and trained on are in `image_sets`, the built-in places in `synthetic`.
"""

from sfgs_jax.datasets._association import associate as associate
from sfgs_jax.datasets._association import poses_at as poses_at
from sfgs_jax.datasets._opening import LAYOUTS as LAYOUTS
from sfgs_jax.datasets._opening import open_recording as open_recording
from sfgs_jax.datasets._options import ReaderOptions as ReaderOptions
from sfgs_jax.datasets._playback import play as play
from sfgs_jax.datasets._prefetch import prefetch as prefetch
from sfgs_jax.datasets._realsense import RealSense as RealSense
from sfgs_jax.datasets._recording import Recording as Recording
from sfgs_jax.datasets._selection import Selection as Selection
from sfgs_jax.datasets._wrapped_recording import WrappedRecording as WrappedRecording
from sfgs_jax.datasets._writers import write_recording as write_recording
from sfgs_jax.datasets.image_sets import HPATCHES_LARGE as HPATCHES_LARGE
from sfgs_jax.datasets.image_sets import PHOTO_LAYOUTS as PHOTO_LAYOUTS
from sfgs_jax.datasets.image_sets import HomographyPair as HomographyPair
from sfgs_jax.datasets.image_sets import Photos as Photos
from sfgs_jax.datasets.image_sets import PosePair as PosePair
from sfgs_jax.datasets.image_sets import RecordingPair as RecordingPair
from sfgs_jax.datasets.image_sets import read_hpatches as read_hpatches
from sfgs_jax.datasets.image_sets import read_megadepth_1500 as read_megadepth_1500
from sfgs_jax.datasets.image_sets import read_pair_list as read_pair_list
from sfgs_jax.datasets.image_sets import read_photos as read_photos
from sfgs_jax.datasets.image_sets import read_scannet_1500 as read_scannet_1500
from sfgs_jax.datasets.image_sets import recording_pairs as recording_pairs
from sfgs_jax.datasets.synthetic import KINECT_V1 as KINECT_V1
from sfgs_jax.datasets.synthetic import KinectFaults as KinectFaults
from sfgs_jax.datasets.synthetic import SyntheticRecording as SyntheticRecording
