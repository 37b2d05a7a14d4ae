"""Results of the graph of keyframes in the state: after each frame, and at the end of a run."""

from dataclasses import replace

from sfgs_jax.arrays import checked
from sfgs_jax.slam.frontend import with_depth_parameters
from sfgs_jax.slam.keyframes import advance_graph, rectified_anew, settled
from sfgs_jax.slam.mapping import follow_keyframes
from sfgs_jax.slam.state import KeyframeGraph, SlamState, with_graph_poses


def with_graph(state: SlamState, graph: KeyframeGraph) -> SlamState:
    """The state with another graph; the tracker's references move with its keyframes.

    Args:
        state: before.
        graph: the state's, after some more work.
    """
    params, tracker = state.params, state.tracker
    if graph.poses is not state.graph.poses:
        tracker = with_graph_poses(tracker, graph)
    if graph.depth_parameters is not state.graph.depth_parameters:
        known = graph.depth_parameters, graph.depth_covariance
        params, tracker = with_depth_parameters(params, tracker, *known)
    return replace(state, graph=graph, tracker=tracker, params=params)


@checked
def finish(state: SlamState) -> SlamState:
    """The state at the end of a run: all waiting pairs of keyframes registered, the keyframes adjusted.

    All keyframes are rectified by the times of the rows as they are known now. While frames come, few pairs
    are registered after each, and an adjustment takes few iterations. The map moves with the keyframes. More
    frames may follow.

    Args:
        state: after the last frame.
    """
    config, times = state.config.graph, state.row_times
    if times is not None and bool(state.tracker.last_motion.known):
        graph = rectified_anew(state.params, state.graph, times, config, deviations=1.0)
        state = replace(state, graph=graph)
    while state.graph.has_waiting:
        graph, _ = advance_graph(state.params, state.graph, config, grown=False)
        state = with_graph(state, graph)
    state = with_graph(state, settled(state.params, state.graph, config))
    return replace(state, mapping=follow_keyframes(state.mapping, state.graph.poses, state.row_times))
