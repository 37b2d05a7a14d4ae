"""The graph of keyframes: registrations between them, and their poses by all of these."""

from collections.abc import Sequence
from dataclasses import replace

import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Float

from sfgs_jax.factor_graph import FactorGraph, RelativePose, SolverConfig, Status, Values, solve
from sfgs_jax.geometry import Kernel, se3
from sfgs_jax.slam.config import GraphConfig
from sfgs_jax.slam.nodes import Edge, Keyframe
from sfgs_jax.slam.registration import Carrier, Registration, extent, register
from sfgs_jax.slam.state import SlamState

_SOLVER = SolverConfig(max_iterations=15, cost_tolerance=1e-4)


def edge_of(target: int, source: int, found: Registration, config: GraphConfig) -> Edge:
    """A registration as an edge of the graph, with the systematic part of its error."""
    information, surface_information = (
        _with_systematic_error(np.asarray(x, np.float64), config)
        for x in (found.information, found.surface_information)
    )
    return Edge(target, source, found.T_target_source, information, surface_information, False)


def _with_systematic_error(information: Float[np.ndarray, "6 6"], config: GraphConfig) -> Array:
    """Information after an error is added that more points or matches make no smaller.

    The depth camera's own distortion moves with the camera, and holds every registration back a little.
    """
    sigmas = np.repeat([config.edge_sigma_metres, config.edge_sigma_radians], 3)
    # (I^-1 + S)^-1 without the inverse of I, which is singular where the surface leaves directions free.
    total = np.linalg.solve(np.eye(6) + information @ np.diag(sigmas**2), information)
    return jnp.asarray((total + total.T) / 2, jnp.float32)


def neighbours(state: SlamState) -> tuple[tuple[int, int], ...]:
    """Pairs of the newest keyframe with earlier ones that see the same, but for its reference.

    Judged by their poses: cameras near each other that look the same way. Without loops only recent ones,
    since a place that is met again after a way around closes a loop, however small the drift.
    """
    config = state.config.graph
    poses = se3.matrices_of(state.keyframe_poses)
    newest = len(poses) - 1
    known = {edge.target for edge in state.edges if edge.source == newest}
    distance = np.linalg.norm(poses[:newest, :3, 3] - poses[newest, :3, 3], axis=1)
    angle = np.arccos(np.clip(poses[:newest, :3, 2] @ poses[newest, :3, 2], -1, 1))
    near = (distance < config.neighbour_distance) & (angle < config.neighbour_angle)
    if not config.loops:
        near &= newest - np.arange(newest) <= config.loop_gap
    order = np.argsort(distance + angle, kind="stable")
    chosen = [int(i) for i in order if near[i] and int(i) not in known][: config.num_neighbours]
    return tuple((i, newest) for i in chosen)


def register_pair(state: SlamState, target: int, source: int) -> tuple[Registration, float]:
    """Register a keyframe to another from where the graph has them, and the correction found.

    Returns:
        The registration, and by how much it disagrees with the graph: metres or radians, the larger.
    """
    a, b = state.keyframes[target], state.keyframes[source]
    guess = se3.compose(se3.inverse(a.T_world_cam), b.T_world_cam)
    found = register(b.observation, a.observation, guess, state.camera, state.config.tracking)
    return found, extent(se3.compose(se3.inverse(guess), found.T_target_source))


def is_edge(state: SlamState, found: Registration, correction: float) -> bool:
    """Whether a registration of neighbours is believed."""
    features = state.config.tracking.features.kind != "none"
    carriers = (Carrier.BOTH, Carrier.KEYPOINTS) if features else (Carrier.SURFACE,)
    return int(found.carrier) in carriers and correction < state.config.graph.max_correction


def optimise_poses(state: SlamState) -> SlamState:
    """All keyframes' poses by all registrations, the first keyframe fixed.

    The kernel bounds what a wrong registration can do. Loops get one that gives them up altogether where
    the rest of the graph contradicts them: dynamic covariance scaling.
    """
    if not state.edges:
        return state
    config = state.config.graph
    room = room_for(state)
    kernels: tuple[Kernel, Kernel] = ("huber", "dynamic_covariance_scaling")
    factors = [
        relative_poses(
            [e for e in state.edges if e.loop == loop],
            2 * room,
            kernel=kernel,
            kernel_width=config.kernel_width,
        )
        for loop, kernel in zip((False, True), kernels, strict=True)
    ]
    free = np.zeros(room, bool)
    free[1 : len(state.keyframes)] = True
    graph = FactorGraph(factors, num_poses=room, free_poses=free, linear_solver="dense")
    solution = solve(graph, Values(jaxlie.SE3(padded_poses(state.keyframe_poses, room))), config=_SOLVER)
    if int(solution.status) in (Status.DIVERGED, Status.SINGULAR):
        return state
    return with_poses(state, np.asarray(solution.values.poses.wxyz_xyz)[: len(state.keyframes)])


def with_poses(state: SlamState, poses: Float[np.ndarray, "n 7"]) -> SlamState:
    """The state with its keyframes moved; the map follows with its next step."""
    keyframes = tuple(
        replace(keyframe, T_world_cam=jaxlie.SE3(jnp.asarray(pose))) if np.any(pose != old) else keyframe
        for keyframe, pose, old in zip(state.keyframes, poses, state.keyframe_poses, strict=True)
    )
    return replace(state, keyframes=keyframes)


def travelled(keyframes: tuple[Keyframe, ...], start: int, end: int) -> float:
    """Length of the way from one keyframe to a later one, metres."""
    poses = np.asarray([k.T_world_cam.wxyz_xyz for k in keyframes[start : end + 1]])
    return float(np.linalg.norm(np.diff(poses[:, 4:], axis=0), axis=1).sum())


def relative_poses(
    edges: Sequence[Edge], room: int, *, kernel: Kernel = "none", kernel_width: float = 1.0
) -> RelativePose:
    """The edges as one block of factors, padded."""
    count = len(edges)
    poses = np.zeros((room, 2), np.int32)
    poses[:, 1] = 1
    motions = np.tile(np.asarray([1, 0, 0, 0, 0, 0, 0], np.float32), (room, 1))
    information = np.tile(np.eye(6, dtype=np.float32), (room, 1, 1))
    for row, edge in enumerate(edges):
        poses[row] = edge.target, edge.source
        motions[row] = edge.T_target_source.wxyz_xyz
        information[row] = edge.information
    return RelativePose(
        poses,
        jaxlie.SE3(jnp.asarray(motions)),
        jnp.asarray(information),
        valid=np.arange(room) < count,
        kernel=kernel,
        kernel_width=kernel_width,
    )


def room_for(state: SlamState) -> int:
    """Keyframes, and half the registrations, that the solver's arrays have room for."""
    room = state.config.graph.capacity
    while room < len(state.keyframes) or 2 * room < len(state.edges):
        room *= 2
    return room


def padded_poses(poses: Float[np.ndarray, "n 7"], room: int) -> Float[Array, "room 7"]:
    """Poses as wxyz_xyz, the last repeated until there are `room`."""
    return jnp.asarray(np.pad(poses, ((0, room - len(poses)), (0, 0)), mode="edge"))
