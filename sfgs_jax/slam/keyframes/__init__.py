"""The keyframe graph at work: insertion, registrations, loops, adjustment, pose graph."""

from sfgs_jax.slam.keyframes._adjustment import Window as Window
from sfgs_jax.slam.keyframes._adjustment import adjust as adjust
from sfgs_jax.slam.keyframes._adjustment import window_of as window_of
from sfgs_jax.slam.keyframes._deferred_adjustment import with_adjustment_begun as with_adjustment_begun
from sfgs_jax.slam.keyframes._deferred_adjustment import with_adjustment_taken as with_adjustment_taken
from sfgs_jax.slam.keyframes._deferred_adjustment import with_frame_passed as with_frame_passed
from sfgs_jax.slam.keyframes._depth_equations import DepthEquations as DepthEquations
from sfgs_jax.slam.keyframes._depth_equations import depth_equations as depth_equations
from sfgs_jax.slam.keyframes._depth_estimate import estimated_depth as estimated_depth
from sfgs_jax.slam.keyframes._edges import edge_of as edge_of
from sfgs_jax.slam.keyframes._edges import relative_poses as relative_poses
from sfgs_jax.slam.keyframes._graph_step import advance_graph as advance_graph
from sfgs_jax.slam.keyframes._graph_step import register_pair as register_pair
from sfgs_jax.slam.keyframes._graph_step import settled as settled
from sfgs_jax.slam.keyframes._insertion import first_keyframe as first_keyframe
from sfgs_jax.slam.keyframes._insertion import insert_keyframe as insert_keyframe
from sfgs_jax.slam.keyframes._insertion import neighbours as neighbours
from sfgs_jax.slam.keyframes._insertion import with_new_keyframes as with_new_keyframes
from sfgs_jax.slam.keyframes._landmarks import positions as positions
from sfgs_jax.slam.keyframes._landmarks import with_positions as with_positions
from sfgs_jax.slam.keyframes._loops import accept_consistent_loops as accept_consistent_loops
from sfgs_jax.slam.keyframes._loops import loop_pairs as loop_pairs
from sfgs_jax.slam.keyframes._loops import travelled as travelled
from sfgs_jax.slam.keyframes._loops import with_candidate as with_candidate
from sfgs_jax.slam.keyframes._pose_graph import bend as bend
from sfgs_jax.slam.keyframes._pose_graph import optimise_poses as optimise_poses
