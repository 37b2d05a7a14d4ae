"""The files that a recording consists of: images, camera files, pose files, and pairs of them as frames.

The readers in `sfgs_jax.datasets.layouts` are built from these functions. So is a reader of another layout.
"""

from sfgs_jax.datasets.files._camera_files import CAMERA_EXAMPLE as CAMERA_EXAMPLE
from sfgs_jax.datasets.files._camera_files import Intrinsics as Intrinsics
from sfgs_jax.datasets.files._camera_files import read_camera_json as read_camera_json
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
from sfgs_jax.datasets.files._images import decode_colour as decode_colour
from sfgs_jax.datasets.files._images import decode_depth as decode_depth
from sfgs_jax.datasets.files._images import depth_units as depth_units
from sfgs_jax.datasets.files._pose_files import read_matrix_file as read_matrix_file
from sfgs_jax.datasets.files._pose_files import read_matrix_rows as read_matrix_rows
from sfgs_jax.datasets.files._pose_files import read_numbers as read_numbers
from sfgs_jax.datasets.files._pose_files import read_text as read_text
from sfgs_jax.datasets.files._pose_files import read_tum_poses as read_tum_poses
