"""Estimate of the distortion of depth, from the registrations between keyframes."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
from jaxtyping import Float

from sfgs_jax.sensors import DEPTH_GRID, DepthCorrection
from sfgs_jax.slam.config import GraphConfig, TrackingConfig
from sfgs_jax.slam.frontend import offsets_in_use
from sfgs_jax.slam.keyframes._depth_equations import depth_equations
from sfgs_jax.slam.keyframes._edges import edge_of
from sfgs_jax.slam.state._depth_information import DepthPrior, depth_prior
from sfgs_jax.slam.state._frame_features import FrameFeatures
from sfgs_jax.slam.state._keyframe_graph import Edge, KeyframeGraph
from sfgs_jax.slam.state._registration import PoseSource, Registration
from sfgs_jax.slam.state._slam_state import SlamState
from sfgs_jax.slam.state._tracker import TrackerParams


def with_registration(
    params: TrackerParams,
    graph: KeyframeGraph,
    target: int,
    source: int,
    features: tuple[FrameFeatures, FrameFeatures],
    found: Registration,
    config: GraphConfig,
    *,
    told: bool = True,
) -> tuple[KeyframeGraph, Edge]:
    """The graph that has heard what a registration says about depth, and the registration as an edge.

    Args:
        params: parameters of tracking.
        graph: before; it does not get the edge.
        target: number of the keyframe registered to.
        source: number of the keyframe registered.
        features: of both, target and source, with the correction of depth of `params`.
        found: the registration, with the correction of depth of `params`.
        config: settings.
        told: whether the registration is believed.
    """
    if params.depth_correction is None:
        return graph, edge_of(target, source, found, config)
    offsets = offsets_in_use(params)
    equations = depth_equations(params, features[1], features[0], found)
    edge = replace(edge_of(target, source, found, config), offsets=offsets, sensitivity=equations.sensitivity)
    if not told or int(found.source) not in (PoseSource.JOINT, PoseSource.SURFACE):
        return graph, edge
    depth = graph.depth.plus(equations.information, equations.vector, offsets, prior_of(params.config))
    return replace(graph, depth=depth), edge


def with_new_offsets(params: TrackerParams, graph: KeyframeGraph) -> KeyframeGraph:
    """The graph with the distortion of depth as the registrations so far show it.

    Args:
        params: parameters of tracking.
        graph: before.
    """
    if params.depth_correction is None:
        return graph
    return replace(graph, offsets=graph.depth.estimate(prior_of(params.config)))


def estimated_depth(state: SlamState) -> tuple[DepthCorrection, Float[np.ndarray, "G G"]] | None:
    """Correction of depth as the keyframes so far show it, and the covariance of its G offsets in 1/m².

    None without `TrackingConfig.estimate_depth`.

    Args:
        state: after these keyframes.
    """
    correction = state.params.depth_correction
    if correction is None:
        return None
    return correction, state.graph.depth.covariance(prior_of(state.params.config))


def prior_of(config: TrackingConfig) -> DepthPrior:
    """Prior of the distortion of depth, as known before the first frame.

    Args:
        config: settings.
    """
    return _prior(config.depth_sigma, config.depth_step_sigma, config.depth_tilt_sigma)


_prior = cache(partial(depth_prior, DEPTH_GRID))
