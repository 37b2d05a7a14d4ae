"""Image sets that keypoints are judged and trained on: pairs with known motion or homography, photographs."""

from sfgs_jax.datasets.image_sets._hpatches import HPATCHES_LARGE as HPATCHES_LARGE
from sfgs_jax.datasets.image_sets._hpatches import read_hpatches as read_hpatches
from sfgs_jax.datasets.image_sets._image_pairs import HomographyPair as HomographyPair
from sfgs_jax.datasets.image_sets._image_pairs import PosePair as PosePair
from sfgs_jax.datasets.image_sets._photos import PHOTO_LAYOUTS as PHOTO_LAYOUTS
from sfgs_jax.datasets.image_sets._photos import Photos as Photos
from sfgs_jax.datasets.image_sets._photos import read_photos as read_photos
from sfgs_jax.datasets.image_sets._pose_pairs import read_megadepth_1500 as read_megadepth_1500
from sfgs_jax.datasets.image_sets._pose_pairs import read_pair_list as read_pair_list
from sfgs_jax.datasets.image_sets._pose_pairs import read_scannet_1500 as read_scannet_1500
from sfgs_jax.datasets.image_sets._recording_pairs import RecordingPair as RecordingPair
from sfgs_jax.datasets.image_sets._recording_pairs import recording_pairs as recording_pairs
