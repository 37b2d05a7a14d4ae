"""Pose of a frame: features, joint registration, judgement, tracking, localisation of lost frames."""

from sfgs_jax.slam.frontend._feature_registration import motion_from_keypoints as motion_from_keypoints
from sfgs_jax.slam.frontend._feature_registration import num_explained as num_explained
from sfgs_jax.slam.frontend._frame_features import feature_shapes as feature_shapes
from sfgs_jax.slam.frontend._frame_features import frame_features as frame_features
from sfgs_jax.slam.frontend._frame_features import host_keypoints as host_keypoints
from sfgs_jax.slam.frontend._frame_features import observe as observe
from sfgs_jax.slam.frontend._frame_features import tracker_params as tracker_params
from sfgs_jax.slam.frontend._joint_registration import Allowed as Allowed
from sfgs_jax.slam.frontend._joint_registration import register as register
from sfgs_jax.slam.frontend._localisation import Localised as Localised
from sfgs_jax.slam.frontend._localisation import find_frame as find_frame
from sfgs_jax.slam.frontend._localisation import localise as localise
from sfgs_jax.slam.frontend._localisation import place as place
from sfgs_jax.slam.frontend._localisation import relocalise as relocalise
from sfgs_jax.slam.frontend._localisation import search_by_surface as search_by_surface
from sfgs_jax.slam.frontend._pose_source import Evidence as Evidence
from sfgs_jax.slam.frontend._pose_source import judge as judge
from sfgs_jax.slam.frontend._pose_source import supports_edge as supports_edge
from sfgs_jax.slam.frontend._pose_source import supports_loop as supports_loop
from sfgs_jax.slam.frontend._pose_source import supports_relocalisation as supports_relocalisation
from sfgs_jax.slam.frontend._rectification import rectified as rectified
from sfgs_jax.slam.frontend._track import TrackInfo as TrackInfo
from sfgs_jax.slam.frontend._track import estimated_timing as estimated_timing
from sfgs_jax.slam.frontend._track import init_tracker as init_tracker
from sfgs_jax.slam.frontend._track import needs_keyframe as needs_keyframe
from sfgs_jax.slam.frontend._track import track as track
