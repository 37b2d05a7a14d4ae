"""Registration of waiting pairs of keyframes, in a thread beside the tracker or at once."""

from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from threading import Event

import equinox as eqx
import jaxlie
import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import PATIENCE
from sfgs_jax.geometry import se3
from sfgs_jax.slam.config import GraphConfig
from sfgs_jax.slam.frontend import depth_parameters_in_use, features_in_use, params_of
from sfgs_jax.slam.frontend._joint_registration import register
from sfgs_jax.slam.keyframes._edges import edge_of
from sfgs_jax.slam.keyframes._pair_equations import PairEquations, pair_equations
from sfgs_jax.slam.state._frame_features import FrameFeatures
from sfgs_jax.slam.state._keyframe_graph import Edge, KeyframeGraph, TrackedPair
from sfgs_jax.slam.state._maps import maps_of
from sfgs_jax.slam.state._registration import Registration
from sfgs_jax.slam.state._tracker import TrackerParams

_beside = ThreadPoolExecutor(1, thread_name_prefix="sfgs_jax registrations")
"""A thread of their own: a frame waits for its registrations, and an adjustment may take as long as ten."""


@dataclass(frozen=True, eq=False)
class RegisteredPair:
    """A pair of keyframes, registered.

    Attributes:
        params: parameters of tracking of that time.
        target: number of the keyframe registered to.
        source: number of the keyframe registered.
        kept: features of both as the graph had them.
        are_apart: whether they were in two maps, so that nobody knew where they lie to each other.
        by_tracking: whether tracking registered it, so that the graph has its edge.
        found: the registration.
        equations: of what is the same for all frames.
        edge: what the graph gets if it believes the registration; the estimates have not heard it yet.
    """

    params: TrackerParams
    target: int
    source: int
    kept: tuple[FrameFeatures, FrameFeatures]
    are_apart: bool
    by_tracking: bool
    found: Registration
    equations: PairEquations
    edge: Edge

    def holds(self, graph: KeyframeGraph) -> bool:
        """True if a later graph has both keyframes as they were registered.

        Args:
            graph: that holds them.
        """
        keyframes = graph.keyframes[self.target], graph.keyframes[self.source]
        if any(keyframe.features is not kept for keyframe, kept in zip(keyframes, self.kept, strict=True)):
            return False
        if not self.are_apart:
            return True  # maps become one, but never fall apart
        maps = maps_of(graph)
        return bool(maps[self.target] != maps[self.source])


class Registrations:
    """Registrations of waiting pairs, made in a thread: while frames are tracked, or between two frames.

    Attributes:
        are_awaited: whether a frame waits for what was begun before it.
    """

    def __init__(self, *, are_awaited: bool = True, patience: float = PATIENCE) -> None:
        """Without any.

        Args:
            are_awaited: whether a frame waits for what was begun before it, so that a run repeats itself.
                Otherwise a later frame takes it, once it is there.
            patience: seconds without a frame after which the tracker counts as idle.
        """
        self.are_awaited = are_awaited
        self._patience = patience
        self._begun: Future[tuple[RegisteredPair, ...]] | None = None
        self._frame_came = Event()

    def begin(self, params: TrackerParams, graph: KeyframeGraph, config: GraphConfig) -> None:
        """Register the pairs whose turn it is, unless others are under way.

        Args:
            params: parameters of tracking.
            graph: before a frame.
            config: settings.
        """
        if self._begun is None:
            self._begun = _beside.submit(registered_pairs, params, graph, config)

    def begin_while_idle(self, params: TrackerParams, graph: KeyframeGraph, config: GraphConfig) -> None:
        """Register one pair, unless a frame comes at once or another is under way.

        Beside registrations without end the tracker would have half of the processor: it then takes longer
        than frames take to come.

        Args:
            params: parameters of tracking.
            graph: after a frame.
            config: settings.
        """
        self._frame_came.clear()
        if self._begun is None and graph.has_waiting:
            self._begun = _beside.submit(self._one_while_idle, params, graph, config)

    def frame_came(self) -> None:
        """The tracker is idle no more."""
        self._frame_came.set()

    def _one_while_idle(
        self, params: TrackerParams, graph: KeyframeGraph, config: GraphConfig
    ) -> tuple[RegisteredPair, ...]:
        if self._frame_came.wait(self._patience):
            return ()
        if graph.tracked:
            return (_tracked(params, graph, graph.tracked[0], config),)
        return _registered_all(params, graph, (*graph.pending, *graph.again)[:1], config)

    def take(self) -> tuple[RegisteredPair, ...] | None:
        """Pairs that a frame's graph is to take; None if a frame is to register them itself."""
        begun = self._begun
        if begun is None:
            return None if self.are_awaited else ()
        if not (self.are_awaited or begun.done()):
            return ()
        self._begun = None
        return begun.result()


def registered_pairs(
    params: TrackerParams, graph: KeyframeGraph, config: GraphConfig
) -> tuple[RegisteredPair, ...]:
    """The waiting pairs whose turn it is after a frame, registered from where the graph has them.

    A keyframe brings some ten pairs, and the next may come soon: a backlog is worked off faster. All that
    tracking registered come first.

    Args:
        params: parameters of tracking.
        graph: before.
        config: settings.
    """
    waiting = (*graph.pending, *graph.again)
    turn = waiting[: max(config.registrations_per_frame, len(waiting) // config.backlog)]
    tracked = [_tracked(params, graph, pair, config) for pair in graph.tracked]
    return (*tracked, *_registered_all(params, graph, turn, config))


def _registered_all(
    params: TrackerParams, graph: KeyframeGraph, pairs: Sequence[tuple[int, int]], config: GraphConfig
) -> tuple[RegisteredPair, ...]:
    maps = maps_of(graph) if pairs else ()
    apart = [bool(maps[target] != maps[source]) for target, source in pairs]
    return tuple(
        _registered(params, graph, pair, config, are_apart=are_apart)
        for pair, are_apart in zip(pairs, apart, strict=True)
    )


def _tracked(
    params: TrackerParams, graph: KeyframeGraph, pair: TrackedPair, config: GraphConfig
) -> RegisteredPair:
    """A pair that tracking registered, with the correction of depth that its newer frame had then."""
    params = params_of(params, graph.keyframes[pair.source])
    ends = pair.target, pair.source
    return _registered(params, graph, ends, config, are_apart=False, by_tracking=pair.found)


def _registered(
    params: TrackerParams,
    graph: KeyframeGraph,
    pair: tuple[int, int],
    config: GraphConfig,
    *,
    are_apart: bool,
    by_tracking: Registration | None = None,
) -> RegisteredPair:
    """A pair with its equations and as an edge, registered now unless tracking did."""
    target, source = (graph.keyframes[number] for number in pair)
    fixed, moving = features_in_use(params, target), features_in_use(params, source)
    if by_tracking is not None:
        # It was read row by row then; the keyframe is rectified.
        pixels = moving.keypoints.features.keypoints
        found = eqx.tree_at(lambda f: f.matched.pixels, by_tracking, pixels)
    else:
        guess = se3.identity() if are_apart else _by_poses(graph, pair)
        found = register(params, moving, fixed, guess, guess_known=not are_apart)
    equations = pair_equations(params, moving, fixed, found)
    return RegisteredPair(
        params=params,
        target=pair[0],
        source=pair[1],
        kept=(target.features, source.features),
        are_apart=are_apart,
        by_tracking=by_tracking is not None,
        found=found,
        equations=equations,
        edge=edge_of(*pair, found, config, depth_parameters_in_use(params), equations.depth),
    )


def _by_poses(graph: KeyframeGraph, pair: tuple[int, int]) -> jaxlie.SE3:
    """T_target_source as the graph has it."""
    target, source = (graph.pose(number) for number in pair)
    return jaxlie.SE3(se3.compose(se3.inverse(target), source).wxyz_xyz)


def disagreement(graph: KeyframeGraph, registered: RegisteredPair) -> Float[np.ndarray, "6"]:
    """Tangent of a registration's disagreement with where the graph has the pair.

    Args:
        graph: that holds both keyframes.
        registered: the pair.
    """
    expected = _by_poses(graph, (registered.target, registered.source))
    return np.asarray(se3.log(se3.compose(se3.inverse(expected), registered.found.T_target_source)))
