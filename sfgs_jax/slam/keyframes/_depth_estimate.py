"""Estimate of the errors of depth, from the registrations between keyframes."""

from dataclasses import replace
from functools import cache

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import checked
from sfgs_jax.sensors import DEPTH_GRID, DepthCorrection
from sfgs_jax.slam.config import GraphConfig, TrackingConfig
from sfgs_jax.slam.frontend import depth_parameters_in_use
from sfgs_jax.slam.keyframes._edges import edge_of
from sfgs_jax.slam.keyframes._pair_equations import PairEquations
from sfgs_jax.slam.keyframes._rectification_anew import rows_known
from sfgs_jax.slam.state._depth_information import DepthPrior, depth_prior, with_extrinsic
from sfgs_jax.slam.state._keyframe_graph import Edge, KeyframeGraph
from sfgs_jax.slam.state._registration import PoseSource, Registration
from sfgs_jax.slam.state._slam_state import SlamState
from sfgs_jax.slam.state._tracker import TrackerParams

_KNOWN = 1e-6
"""Deviation of an extrinsic that is not estimated, metres and radians."""


def with_registration(
    params: TrackerParams,
    graph: KeyframeGraph,
    target: int,
    source: int,
    equations: PairEquations,
    found: Registration,
    config: GraphConfig,
    *,
    told: bool = True,
) -> tuple[KeyframeGraph, Edge]:
    """The graph that has heard what a registration says about the camera, and the registration as an edge.

    Args:
        params: parameters of tracking.
        graph: before; it does not get the edge.
        target: number of the keyframe registered to.
        source: number of the keyframe registered.
        equations: of the registration.
        found: the registration, with the correction of depth of `params`.
        config: settings.
        told: whether the registration is believed, and the estimates may hear it.
    """
    in_use, depth = depth_parameters_in_use(params), equations.depth
    edge = edge_of(target, source, found, config, in_use)
    if depth is not None:
        edge = replace(edge, sensitivity=depth.sensitivity, surface_sensitivity=depth.surface_sensitivity)
    told &= int(found.source) in (PoseSource.JOINT, PoseSource.SURFACE)
    # Rows that lie where they don't belong look like a camera that does not.
    told &= not params.config.estimate_extrinsic or rows_known(graph, (target, source), config)
    if not told:
        return graph, edge
    # Pairs of the same images say the same, as edges do.
    share = 1 / graph.noise.redundancy
    graph = replace(graph, focal=graph.focal.joined(equations.focal.of_which(share)))
    if depth is not None:
        told_of = share * depth.information, share * depth.vector
        graph = replace(graph, depth=graph.depth.plus(*told_of, in_use, prior_of(params.config)))
    return graph, replace(edge, told=True)


def with_new_depth_parameters(params: TrackerParams, graph: KeyframeGraph) -> KeyframeGraph:
    """The graph with the errors of depth as the registrations so far show them.

    Args:
        params: parameters of tracking.
        graph: before.
    """
    if params.depth_correction is None:
        return graph
    return replace(graph, depth_parameters=graph.depth.estimate(prior_of(params.config)))


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
    return correction, state.graph.depth.covariance(prior_of(state.params.config))


def prior_of(config: TrackingConfig) -> DepthPrior:
    """Prior of the errors of depth, as known before the first frame.

    Args:
        config: settings.
    """
    shift, turn = config.extrinsic_shift_sigma, config.extrinsic_turn_sigma
    if not config.estimate_extrinsic:
        shift = turn = _KNOWN
    return _prior(config.depth_sigma, config.depth_step_sigma, config.depth_tilt_sigma, shift, turn)


@cache
def _prior(
    sigma: float, step_sigma: float, tilt_sigma: float, shift_sigma: float, turn_sigma: float
) -> DepthPrior:
    return with_extrinsic(depth_prior(DEPTH_GRID, sigma, step_sigma, tilt_sigma), shift_sigma, turn_sigma)
