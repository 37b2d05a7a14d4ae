"""The files that a recording consists of: images, camera files, pose files, and pairs of them as frames.

The readers in `sfgs_jax.datasets.layouts` are built from these functions. So is a reader of another layout.
"""

from sfgs_jax.datasets.files._camera_files import CAMERA_EXAMPLE as CAMERA_EXAMPLE
from sfgs_jax.datasets.files._camera_files import Intrinsics as Intrinsics
from sfgs_jax.datasets.files._camera_files import one_camera as one_camera
from sfgs_jax.datasets.files._camera_files import read_camera_json as read_camera_json
from sfgs_jax.datasets.files._common_size import CommonView as CommonView
from sfgs_jax.datasets.files._common_size import common_view as common_view
from sfgs_jax.datasets.files._common_size import resized_depth as resized_depth
from sfgs_jax.datasets.files._common_size import scaled_intrinsics as scaled_intrinsics
from sfgs_jax.datasets.files._confidence import ConfidentDepth as ConfidentDepth
from sfgs_jax.datasets.files._confidence import confident as confident
from sfgs_jax.datasets.files._file_recording import FilePair as FilePair
from sfgs_jax.datasets.files._file_recording import FileRecording as FileRecording
from sfgs_jax.datasets.files._file_recording import PairRegistration as PairRegistration
from sfgs_jax.datasets.files._file_recording import depth_notes as depth_notes
from sfgs_jax.datasets.files._file_recording import first_readable as first_readable
from sfgs_jax.datasets.files._file_recording import registered_size as registered_size
from sfgs_jax.datasets.files._file_recording import size_text as size_text
from sfgs_jax.datasets.files._folders import images_by_number as images_by_number
from sfgs_jax.datasets.files._folders import images_in as images_in
from sfgs_jax.datasets.files._folders import natural_key as natural_key
from sfgs_jax.datasets.files._ground_truth import ground_truth_by_frame as ground_truth_by_frame
from sfgs_jax.datasets.files._ground_truth import ground_truth_by_time as ground_truth_by_time
from sfgs_jax.datasets.files._ground_truth import not_finite_notes as not_finite_notes
from sfgs_jax.datasets.files._images import COLOUR_SUFFIXES as COLOUR_SUFFIXES
from sfgs_jax.datasets.files._images import DEPTH_SUFFIXES as DEPTH_SUFFIXES
from sfgs_jax.datasets.files._images import ColourImage as ColourImage
from sfgs_jax.datasets.files._images import DepthImage as DepthImage
from sfgs_jax.datasets.files._images import colour_of_bgr as colour_of_bgr
from sfgs_jax.datasets.files._images import colour_of_bytes as colour_of_bytes
from sfgs_jax.datasets.files._images import decode_colour as decode_colour
from sfgs_jax.datasets.files._images import decode_depth as decode_depth
from sfgs_jax.datasets.files._images import depth_of_array as depth_of_array
from sfgs_jax.datasets.files._images import depth_of_bytes as depth_of_bytes
from sfgs_jax.datasets.files._images import depth_units as depth_units
from sfgs_jax.datasets.files._listed_files import is_time as is_time
from sfgs_jax.datasets.files._listed_files import listed_file as listed_file
from sfgs_jax.datasets.files._listed_files import read_json as read_json
from sfgs_jax.datasets.files._listed_files import times_of_names as times_of_names
from sfgs_jax.datasets.files._lzfse import decompress_lzfse as decompress_lzfse
from sfgs_jax.datasets.files._lzfse import require_lzfse as require_lzfse
from sfgs_jax.datasets.files._pose_files import opencv_poses as opencv_poses
from sfgs_jax.datasets.files._pose_files import quaternion_poses as quaternion_poses
from sfgs_jax.datasets.files._pose_files import read_matrix_file as read_matrix_file
from sfgs_jax.datasets.files._pose_files import read_matrix_rows as read_matrix_rows
from sfgs_jax.datasets.files._pose_files import read_numbers as read_numbers
from sfgs_jax.datasets.files._pose_files import read_table as read_table
from sfgs_jax.datasets.files._pose_files import read_text as read_text
from sfgs_jax.datasets.files._pose_files import read_tum_poses as read_tum_poses
from sfgs_jax.datasets.files._pose_files import rigid_poses as rigid_poses
from sfgs_jax.datasets.files._video import VIDEO_SUFFIXES as VIDEO_SUFFIXES
from sfgs_jax.datasets.files._video import Video as Video
from sfgs_jax.datasets.files._video import VideoFrame as VideoFrame
