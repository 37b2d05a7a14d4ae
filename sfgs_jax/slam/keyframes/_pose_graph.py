"""Pose graph: the poses of all keyframes by the motions between them."""

from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import replace
from functools import partial

import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Float

from sfgs_jax.arrays import Background, doubled
from sfgs_jax.factor_graph import Capacities, FactorGraph, SolverConfig, Status, Values, solve
from sfgs_jax.geometry import se3
from sfgs_jax.slam.config import GraphConfig
from sfgs_jax.slam.keyframes._edges import CONSISTENT, motions_of, relative_poses
from sfgs_jax.slam.state._keyframe_graph import Edge, KeyframeGraph
from sfgs_jax.slam.state._maps import first_keyframes

_SOLVER = SolverConfig(max_iterations=15, cost_tolerance=1e-3, step_tolerance=1e-4)
"""A thousandth of the cost is far less than chance changes it by, and with less float32 goes in circles.
Edges that agree have no cost to be a share of; a tenth of a millimetre is less than any of them knows."""

_LEAST_EDGES, _EDGES_PER_KEYFRAME = 512, 4
"""Edges that a graph has room for, whichever is more; a way through a building has three per keyframe."""

_background = Background()


def optimise_poses(graph: KeyframeGraph, config: GraphConfig) -> KeyframeGraph:
    """The graph with all keyframes' poses by all registrations, the first keyframe of each map fixed.

    A Huber kernel bounds the effect of a wrong registration. Loops get dynamic covariance scaling, which
    gives them up altogether where the rest of the graph contradicts them.

    Args:
        graph: before.
        config: settings.
    """
    if not graph.edges:
        return graph
    loops = [edge for edge in graph.edges if edge.loop]
    return _solved(graph, config, [edge for edge in graph.edges if not edge.loop], loops)


def bend(graph: KeyframeGraph, config: GraphConfig) -> KeyframeGraph:
    """The graph bent by its new edges; all else wants to stay as it is, by the information of its edges.

    The poses hold already what surfaces and landmarks say, those of keyframes too that are adjusted no more.
    Source: the essential graph of ORB-SLAM2 (Mur-Artal and Tardós, 2017), section III-C.

    Args:
        graph: before.
        config: settings.
    """
    old, new = graph.edges[: graph.num_absorbed], graph.edges[graph.num_absorbed :]
    T = se3.matrices_of(graph.poses)
    ends = np.asarray([(edge.target, edge.source) for edge in old], int).reshape(-1, 2)
    motions = se3.parameters_of(np.linalg.inv(T[ends[:, 0]]) @ T[ends[:, 1]])
    held = [
        replace(edge, T_target_source=motion, depth_parameters=graph.depth_parameters)
        for edge, motion in zip(old, motions, strict=True)
    ]
    return _solved(
        graph, config, [*held, *(e for e in new if not e.loop)], [edge for edge in new if edge.loop]
    )


def is_contradicted(graph: KeyframeGraph) -> bool:
    """True if a place is seen again elsewhere than where the graph has it, beyond the error of the edge.

    Args:
        graph: with the edges that it has not absorbed.
    """
    again = [edge for edge in graph.edges[graph.num_absorbed :] if edge.revisit]
    if not again:
        return False
    ends = np.asarray([(edge.target, edge.source) for edge in again])
    T, found = se3.matrices_of(graph.poses), se3.matrices_of(motions_of(again, graph.depth_parameters))
    off = se3.logs_of(np.linalg.inv(found) @ np.linalg.inv(T[ends[:, 0]]) @ T[ends[:, 1]])
    told = replace(graph.noise, redundancy=1.0).share(np.stack([edge.information for edge in again]))
    return bool(np.einsum("ni,nij,nj->n", off, told, off).max() > CONSISTENT)


def _solved(
    graph: KeyframeGraph, config: GraphConfig, steady: Sequence[Edge], loops: Sequence[Edge]
) -> KeyframeGraph:
    """The graph at the optimum, unless there is none."""
    capacity = pose_capacity(graph, config)
    problem = _problem(graph, config, capacity, steady, loops)
    start = Values(jaxlie.SE3(padded_poses(graph.poses, capacity)))
    solution = solve(problem, start, config=_SOLVER)
    if int(solution.status) in (Status.DIVERGED, Status.SINGULAR):
        return graph
    found = np.asarray(solution.values.poses.wxyz_xyz)[: len(graph.keyframes)]
    return replace(graph, poses=found)


def _problem(
    graph: KeyframeGraph, config: GraphConfig, capacity: int, steady: Sequence[Edge], loops: Sequence[Edge]
) -> FactorGraph:
    """Edges over all keyframes; graphs of one capacity mostly run one program, which is sparse if large."""
    room = _edge_room(graph, capacity)
    block = partial(
        relative_poses,
        noise=graph.noise,
        depth_parameters=graph.depth_parameters,
        kernel_width=config.kernel_width,
    )
    factors = [
        block(steady, room, kernel="huber"),
        block(loops, doubled(capacity, len(loops)), kernel="dynamic_covariance_scaling"),
    ]
    free = np.zeros(capacity, bool)
    free[: len(graph.keyframes)] = ~first_keyframes(graph)
    capacities = Capacities.for_trajectory(edges=room)
    return FactorGraph(factors, num_poses=capacity, free_poses=free, capacities=capacities)


def _edge_room(graph: KeyframeGraph, capacity: int) -> int:
    """Room for edges, by how many a keyframe has: what is compiled ahead then suits the graphs to come."""
    per_keyframe = -(-len(graph.edges) // max(1, len(graph.keyframes)))
    return doubled(max(_LEAST_EDGES, _EDGES_PER_KEYFRAME * capacity), per_keyframe * capacity)


def compile_ahead(graph: KeyframeGraph, config: GraphConfig) -> Future[object] | None:
    """Compile the solver for twice as many keyframes in the background, once it is three quarters full.

    Args:
        graph: that grows.
        config: settings.

    Returns:
        Done when it is compiled; None if there is room enough, or it has been asked for before.
    """
    capacity = pose_capacity(graph, config)
    if len(graph.keyframes) <= capacity * 3 // 4:
        return None
    return _background.once((2 * capacity, config), _compile, graph, config, 2 * capacity)


def _compile(graph: KeyframeGraph, config: GraphConfig, capacity: int) -> None:
    problem = _problem(graph, config, capacity, graph.edges[:1], ())
    solve(problem, Values(jaxlie.SE3(padded_poses(graph.poses, capacity))), config=_SOLVER)


def pose_capacity(graph: KeyframeGraph, config: GraphConfig) -> int:
    """Keyframes that the solver's arrays have room for.

    Args:
        graph: to be optimised.
        config: settings.
    """
    return doubled(config.capacity, len(graph.keyframes))


def padded_poses(poses: Float[np.ndarray, "n 7"], capacity: int) -> Float[Array, "c 7"]:
    """Poses as wxyz_xyz, the last one repeated up to `capacity`.

    Args:
        poses: (n, 7) as wxyz_xyz.
        capacity: rows of the result.
    """
    return jnp.asarray(np.pad(poses, ((0, capacity - len(poses)), (0, 0)), mode="edge"))
