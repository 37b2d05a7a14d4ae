"""Loop closure: candidates by looks, verification by registration, consistency, and a bound on drift."""

from dataclasses import replace

import jaxlie
import numpy as np

from sfgs_jax.factor_graph import Values, consistent_loops
from sfgs_jax.geometry import se3
from sfgs_jax.slam.graph import padded_poses, relative_poses, room_for, travelled
from sfgs_jax.slam.nodes import Edge
from sfgs_jax.slam.registration import Carrier, Registration
from sfgs_jax.slam.state import SlamState
from sfgs_jax.slam.tracking import similarities


def loop_pairs(state: SlamState) -> tuple[tuple[int, int], ...]:
    """Pairs of the newest keyframe with earlier ones that look like it, to be registered."""
    config = state.config.graph
    newest = len(state.keyframes) - 1
    old = newest - config.loop_gap
    if not config.loops or old < 1:
        return ()
    alike = similarities(state, state.keyframes[newest].observation)[:old]
    order = np.argsort(-alike, kind="stable")[: config.loop_candidates]
    return tuple((int(i), newest) for i in order if alike[i] > config.loop_similarity)


def is_candidate(state: SlamState, target: int, source: int, found: Registration) -> bool:
    """Whether a registration may close a loop: both kinds of residuals bear it out, and drift explains it.

    Two rooms that look the same pass every test of looks and of fit; what tells them apart is that the way
    between them was too short for so large an error.
    """
    config = state.config.graph
    if not config.loops or source - target <= config.loop_gap:
        return False
    borne_out = (
        int(found.carrier) == Carrier.BOTH
        and int(found.matched.num_inliers) >= config.loop_inliers
        and float(found.inlier_fraction) >= config.loop_inlier_fraction
    )
    a, b = state.keyframes[target].T_world_cam, state.keyframes[source].T_world_cam
    expected = se3.compose(se3.inverse(a), b)
    off = np.asarray(se3.log(se3.compose(se3.inverse(expected), found.T_target_source)))
    bound = 0.3 + config.max_drift * travelled(state.keyframes, target, source)
    return bool(borne_out and np.linalg.norm(off[:3]) < bound and np.linalg.norm(off[3:]) < config.max_turn)


def believe(state: SlamState) -> tuple[SlamState, bool]:
    """Turn the candidates that agree with each other into loops, if there are enough of them.

    Returns:
        The state, and whether a loop was closed.
    """
    config = state.config.graph
    candidates = state.candidates
    if len(candidates) < config.loop_support:
        return state, False
    poses = padded_poses(state.keyframe_poses, room_for(state))
    agreed = consistent_loops(relative_poses(candidates, _REMEMBERED), Values(jaxlie.SE3(poses)))
    if agreed.sum() < config.loop_support:
        return state, False
    closed = tuple(
        replace(e, loop=True) for e, good in zip(candidates, agreed[: len(candidates)], strict=True) if good
    )
    return replace(state, edges=(*state.edges, *closed), candidates=()), True


def with_candidate(state: SlamState, candidate: Edge) -> SlamState:
    """The state with one more loop to be believed or not; old ones that found no support make room."""
    return replace(state, candidates=(*state.candidates, candidate)[-_REMEMBERED:])


_REMEMBERED = 16
"""Candidates that wait for others to agree with them."""
