"""The keyframe graph at work: insertion, registrations, loops, adjustment, pose graph."""

from sfgs_jax.slam.keyframes._adjustment import Adjusted as Adjusted
from sfgs_jax.slam.keyframes._adjustment import Window as Window
from sfgs_jax.slam.keyframes._adjustment import adjust as adjust
from sfgs_jax.slam.keyframes._adjustment import window_of as window_of
from sfgs_jax.slam.keyframes._covariances import covariances_in_world as covariances_in_world
from sfgs_jax.slam.keyframes._covariances import motion_covariance as motion_covariance
from sfgs_jax.slam.keyframes._deferred_adjustment import with_adjustment_begun as with_adjustment_begun
from sfgs_jax.slam.keyframes._deferred_adjustment import with_adjustment_taken as with_adjustment_taken
from sfgs_jax.slam.keyframes._deferred_adjustment import with_frame_passed as with_frame_passed
from sfgs_jax.slam.keyframes._depth_drift import with_drift_since as with_drift_since
from sfgs_jax.slam.keyframes._depth_equations import DepthEquations as DepthEquations
from sfgs_jax.slam.keyframes._depth_equations import depth_equations as depth_equations
from sfgs_jax.slam.keyframes._depth_estimate import estimated_depth as estimated_depth
from sfgs_jax.slam.keyframes._depth_estimate import (
    with_new_depth_parameters as with_new_depth_parameters,
)
from sfgs_jax.slam.keyframes._edge_noise import edge_noise as edge_noise
from sfgs_jax.slam.keyframes._edges import edge_of as edge_of
from sfgs_jax.slam.keyframes._edges import prior_noise as prior_noise
from sfgs_jax.slam.keyframes._edges import relative_poses as relative_poses
from sfgs_jax.slam.keyframes._focal_lengths import focal_lengths_by as focal_lengths_by
from sfgs_jax.slam.keyframes._graph_step import advance_graph as advance_graph
from sfgs_jax.slam.keyframes._insertion import NewKeyframe as NewKeyframe
from sfgs_jax.slam.keyframes._insertion import first_keyframe as first_keyframe
from sfgs_jax.slam.keyframes._insertion import insert_keyframe as insert_keyframe
from sfgs_jax.slam.keyframes._insertion import neighbours as neighbours
from sfgs_jax.slam.keyframes._insertion import with_new_keyframes as with_new_keyframes
from sfgs_jax.slam.keyframes._joining import joined_graphs as joined_graphs
from sfgs_jax.slam.keyframes._joining import pairs_that_look_alike as pairs_that_look_alike
from sfgs_jax.slam.keyframes._joining import pairs_that_see_the_same as pairs_that_see_the_same
from sfgs_jax.slam.keyframes._joining import tied as tied
from sfgs_jax.slam.keyframes._landmarks import positions as positions
from sfgs_jax.slam.keyframes._landmarks import with_positions as with_positions
from sfgs_jax.slam.keyframes._loops import accept_consistent_loops as accept_consistent_loops
from sfgs_jax.slam.keyframes._loops import likely_drift as likely_drift
from sfgs_jax.slam.keyframes._loops import loop_pairs as loop_pairs
from sfgs_jax.slam.keyframes._loops import with_candidate as with_candidate
from sfgs_jax.slam.keyframes._merging import merged as merged
from sfgs_jax.slam.keyframes._pair_registration import RegisteredPair as RegisteredPair
from sfgs_jax.slam.keyframes._pair_registration import Registrations as Registrations
from sfgs_jax.slam.keyframes._pair_registration import registered_pairs as registered_pairs
from sfgs_jax.slam.keyframes._pose_graph import bend as bend
from sfgs_jax.slam.keyframes._pose_graph import compile_ahead as compile_ahead
from sfgs_jax.slam.keyframes._pose_graph import is_contradicted as is_contradicted
from sfgs_jax.slam.keyframes._pose_graph import optimise_poses as optimise_poses
from sfgs_jax.slam.keyframes._rectification_anew import rectified_anew as rectified_anew
from sfgs_jax.slam.keyframes._rectification_anew import with_first_motion as with_first_motion
from sfgs_jax.slam.keyframes._rectification_anew import with_motion_to_next as with_motion_to_next
from sfgs_jax.slam.keyframes._rectification_anew import (
    with_pairs_of_known_motion as with_pairs_of_known_motion,
)
from sfgs_jax.slam.keyframes._revisit import return_to_keyframe as return_to_keyframe
from sfgs_jax.slam.keyframes._revisit import revisited as revisited
from sfgs_jax.slam.keyframes._settling import settled as settled
