"""Estimate of the errors of depth, from the registrations between keyframes."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import checked
from sfgs_jax.sensors import DepthCorrection
from sfgs_jax.slam.config import GraphConfig
from sfgs_jax.slam.keyframes._pair_registration import RegisteredPair
from sfgs_jax.slam.keyframes._rectification_anew import rows_known
from sfgs_jax.slam.state._depth_hypotheses import depth_estimate
from sfgs_jax.slam.state._depth_information import prior_of
from sfgs_jax.slam.state._keyframe_graph import Edge, KeyframeGraph
from sfgs_jax.slam.state._registration import PoseSource
from sfgs_jax.slam.state._slam_state import SlamState
from sfgs_jax.slam.state._tracker import TrackerParams


def with_edge_heard(
    graph: KeyframeGraph, pair: RegisteredPair, config: GraphConfig
) -> tuple[KeyframeGraph, Edge]:
    """The graph that has heard what an edge says about the camera, and the edge.

    Args:
        graph: before; it does not get the edge.
        pair: the registration, which is believed.
        config: settings.
    """
    tracking, edge, depth = pair.params.config, pair.edge, pair.equations.depth
    told = int(pair.found.source) in (PoseSource.JOINT, PoseSource.SURFACE)
    if not told:
        return graph, edge
    # Pairs of the same images say the same, as edges do.
    share = 1 / graph.noise.redundancy
    graph = replace(graph, focal=graph.focal.joined(pair.equations.focal.of_which(share)))
    if depth is not None:
        # Rows of keypoints that lie where they don't belong look like a camera that does not.
        ends = edge.target, edge.source
        both = tracking.estimate_extrinsic and rows_known(graph, ends, config)
        by = depth.by_both if both else depth.by_surface
        told_of = share * by.information, share * by.vector
        total = graph.depth.plus(*told_of, edge.depth_parameters, prior_of(tracking))
        graph = replace(graph, depth=total)
    return graph, replace(edge, told=True)


def with_new_depth_parameters(params: TrackerParams, graph: KeyframeGraph) -> KeyframeGraph:
    """The graph with the errors of depth as the registrations so far show them.

    Args:
        params: parameters of tracking.
        graph: before.
    """
    if params.depth_correction is None:
        return graph
    mean, covariance = depth_estimate(graph.depth, params.config)
    return replace(graph, depth_parameters=mean, depth_covariance=covariance)


@checked
def estimated_depth(state: SlamState) -> tuple[DepthCorrection, Float[np.ndarray, "G G"]] | None:
    """Correction of depth as the keyframes so far show it, and the covariance of its G parameters.

    None without `TrackingConfig.estimate_depth`.

    Args:
        state: after these keyframes.
    """
    correction = state.params.depth_correction
    if correction is None:
        return None
    return correction, depth_estimate(state.graph.depth, state.params.config).covariance
