"""Adjustment of the graph: keyframes and landmarks by all that surfaces and keypoints say about them."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.arrays import checked
from sfgs_jax.factor_graph import (
    Capacities,
    FactorGraph,
    PosePrior,
    RgbdReprojection,
    Solution,
    SolverConfig,
    Values,
    differentiable_optimum,
    marginal_covariances,
    solve,
)
from sfgs_jax.sensors import DEPTH_GRID, corrected_depth, depth_slopes, grid_values
from sfgs_jax.slam.config import GraphConfig
from sfgs_jax.slam.keyframes._covariances import best_known
from sfgs_jax.slam.keyframes._edges import relative_poses
from sfgs_jax.slam.keyframes._landmarks import chosen, positions, thinned
from sfgs_jax.slam.state._keyframe_graph import KeyframeGraph
from sfgs_jax.slam.state._maps import first_keyframes
from sfgs_jax.slam.state._tracker import TrackerParams

_SOLVER = SolverConfig(max_iterations=4, cost_tolerance=1e-3)
"""An adjustment starts where the one before ended, so that a few iterations are enough. The last thousandth
of the cost takes half of them and moves poses by tenths of a millimetre."""
_OBSERVATIONS = 4
"""Room for observations, per landmark."""
_LOOSE = 1.0
"""Deviation of the prior that keeps a keyframe without residuals in its place, metres and radians."""


class Window(eqx.Module):
    """The problem of an adjustment, padded to fixed shapes.

    Attributes:
        graph: reprojections of the landmarks, the surfaces' registrations between the keyframes, and loops.
        values: poses and landmarks to start from.
        members: (W,) number of the keyframe of each pose; -1 where unused.
        anchor: place among them of the keyframe that covariances are relative to, the best known.
        landmarks: (L,) number of each landmark; -1 where unused.
        depth_parameters: (W, G) by how much those of the depth correction have changed since the depth of
            each keyframe's keypoints was measured.
        normals: (O, 3) of the surface at each observation.
    """

    graph: FactorGraph
    values: Values
    members: Int[Array | np.ndarray, " W"]
    anchor: Int[Array | np.ndarray, ""]
    landmarks: Int[Array | np.ndarray, " L"]
    depth_parameters: Float[Array | np.ndarray, "W G"]
    normals: Float[Array | np.ndarray, "O 3"]


class Adjusted(eqx.Module):
    """Result of an adjustment.

    Attributes:
        solution: poses and landmarks, and how the solver got there.
        covariances: (W, 6, 6) of the poses' tangents, metres and radians, as if the anchor were known.
    """

    solution: Solution
    covariances: Float[Array, "W 6 6"]


@checked
@jax.jit
def adjust(params: TrackerParams, window: Window) -> Adjusted:
    """Poses and landmarks of a window: GICP's registrations and reprojections in one Levenberg-Marquardt.

    A pure function on pytrees of fixed shapes, compiled once. SFGS-SLAM (Wang and Deng, 2025), section 3.3.

    Values and covariances are differentiable by the camera and by all that the window holds, by the implicit
    function theorem. Their derivative is that of the optimum. Adjust a few times in a row, each from the
    values of the time before, to come to it.

    Args:
        params: parameters of tracking; the camera's intrinsics are those of every reprojection.
        window: from `window_of`.
    """
    seen = _reprojections(window.graph)
    depth = seen.depth
    if window.depth_parameters.shape[1]:
        pixels, camera, by = jnp.asarray(seen.pixels), params.camera, jnp.asarray(seen.poses)[:, 0]
        changes = jnp.asarray(window.depth_parameters)
        grids = changes[:, :-6].reshape(-1, *DEPTH_GRID)
        depth = corrected_depth(depth, grid_values(grids, by, pixels, camera))
        slopes = depth_slopes(
            camera.unproject(pixels, jnp.where(depth > 0, depth, 1)).T, jnp.asarray(window.normals).T
        )
        depth = depth * (1 + jnp.sum(slopes * changes[:, -6:][by].T, axis=0))
    graph = eqx.tree_at(
        lambda g: (_reprojections(g).camera, _reprojections(g).depth), window.graph, (params.camera, depth)
    )
    solution = solve(*lax.stop_gradient((graph, window.values)), config=_SOLVER)
    solution = replace(solution, values=differentiable_optimum(graph, solution.values))
    # Poses that are held are held to spare time. They are known no better for it.
    numbers = np.arange(graph.num_poses)
    unknown = (jnp.asarray(window.members) >= 0) & (numbers != window.anchor)
    graph = eqx.tree_at(lambda g: g.free_poses, graph, unknown)
    return Adjusted(solution, marginal_covariances(graph, solution.values, poses=numbers).poses)


def _reprojections(graph: FactorGraph) -> RgbdReprojection:
    return next(f for f in graph.factors if isinstance(f, RgbdReprojection))


@checked
def window_of(
    params: TrackerParams, graph: KeyframeGraph, config: GraphConfig, *, around: int | None = None
) -> Window:
    """The window around a keyframe: all keyframes, where there are few enough.

    The first keyframe of the map keeps it in place, and so do keyframes that are tied to others outside.

    Args:
        params: parameters of tracking.
        graph: with at least two keyframes.
        config: settings.
        around: number of that keyframe, the newest if not given.
    """
    size = config.window
    members = _members(graph, size, len(graph.keyframes) - 1 if around is None else around)
    count = len(members)
    place = np.full(len(graph.keyframes), -1)
    place[members] = np.arange(count)
    observations, landmarks, normals = _observations(params, graph, config, members)
    points = np.zeros((config.max_landmarks, 3), np.float32)
    points[: len(landmarks)] = positions(graph, landmarks)
    poses = np.pad(graph.poses[members], ((0, size - count), (0, 0)), mode="edge")
    problem = FactorGraph(
        [observations, *_registrations(graph, config, place), _loose_prior(poses)],
        num_poses=size,
        num_landmarks=config.max_landmarks,
        free_poses=_free(graph, place, members, size),
        free_landmarks=np.arange(config.max_landmarks) < len(landmarks),
        linear_solver="dense",
        capacities=_capacities(config),
    )
    changes = np.zeros((size, len(graph.depth_parameters)), np.float32)
    changes[:count] = [
        graph.depth_parameters - graph.keyframes[number].depth_parameters for number in members
    ]
    return Window(
        problem,
        Values(jaxlie.SE3(jnp.asarray(poses)), jnp.asarray(points)),
        np.pad(members, (0, size - count), constant_values=-1),
        np.asarray(best_known(graph.covariances[members])),
        np.pad(landmarks, (0, config.max_landmarks - len(landmarks)), constant_values=-1),
        changes,
        normals,
    )


def has_landmarks(params: TrackerParams, config: GraphConfig) -> bool:
    """Whether keyframes are adjusted with landmarks, and not by registrations alone.

    Args:
        params: parameters of tracking.
        config: settings.
    """
    return config.window > 1 and params.config.features.kind != "none"


def _capacities(config: GraphConfig) -> Capacities:
    return Capacities.for_window(landmarks=config.max_landmarks, poses=config.window)


def _members(graph: KeyframeGraph, size: int, around: int) -> Int[np.ndarray, " w"]:
    """Numbers of the keyframes with the fewest edges between them and one of them; of these the newest."""
    count = len(graph.keyframes)
    tied: list[set[int]] = [set() for _ in range(count)]
    for edge in graph.edges:
        tied[edge.target].add(edge.source)
        tied[edge.source].add(edge.target)
    reached, ring, known = [around], {around}, {around}
    while ring and len(reached) < size:
        ring = set().union(*(tied[number] for number in ring)) - known
        known |= ring
        reached += sorted(ring, reverse=True)
    return np.sort(np.asarray(reached[:size]))


def _free(
    graph: KeyframeGraph, place: Int[np.ndarray, " n"], members: Int[np.ndarray, " w"], size: int
) -> Bool[np.ndarray, " W"]:
    """Poses that move: those of keyframes tied to no keyframe outside, but for the first of the map."""
    free = np.zeros(size, bool)
    free[: len(members)] = ~first_keyframes(graph)[members]
    for edge in graph.edges:
        a, b = place[edge.target], place[edge.source]
        if (a < 0) != (b < 0):
            free[max(a, b)] = False
    if not (~free[: len(members)]).any():
        free[0] = False
    return free


def _registrations(graph: KeyframeGraph, config: GraphConfig, place: Int[np.ndarray, " n"]) -> list:
    """Registrations between members by the surface alone, since the keypoints' share is the landmarks'.

    Loops have no landmarks in common with what they close to, so that they count whole.
    """
    inside = [
        replace(edge, target=int(place[edge.target]), source=int(place[edge.source]))
        for edge in graph.edges
        if place[edge.target] >= 0 and place[edge.source] >= 0
    ]
    surfaces, loops = ([edge for edge in inside if edge.loop == loop] for loop in (False, True))
    room = config.window * (config.num_neighbours + 1)
    return [
        relative_poses(
            surfaces[-room:],
            room,
            noise=graph.noise,
            depth_parameters=graph.depth_parameters,
            surface_only=True,
            kernel="huber",
            kernel_width=config.kernel_width,
        ),
        relative_poses(
            loops[-config.window :],
            config.window,
            noise=graph.noise,
            depth_parameters=graph.depth_parameters,
            kernel="dynamic_covariance_scaling",
            kernel_width=config.kernel_width,
        ),
    ]


def _observations(
    params: TrackerParams, graph: KeyframeGraph, config: GraphConfig, members: Int[np.ndarray, " w"]
) -> tuple[RgbdReprojection, Int[np.ndarray, " l"], Float[np.ndarray, "O 3"]]:
    """Reprojections of the members' landmarks, the numbers of these, and the normals at the former."""
    keyframes = [graph.keyframes[number] for number in members]
    shown = np.stack([keyframe.landmarks for keyframe in keyframes])
    placed = shown >= 0
    placed[placed] = graph.landmarks.keyframes[shown[placed]] >= 0
    row, slot = np.nonzero(placed)
    numbers, index = chosen(row, shown[row, slot], config.max_landmarks)
    # The best landmarks first: where there are too many observations, the others lose theirs.
    order = np.argsort(np.where(index >= 0, index, config.max_landmarks), kind="stable")
    order = order[: (index >= 0).sum()]
    # One that more keyframes see than a cluster holds would make every cluster larger, and a new program.
    room = _OBSERVATIONS * config.max_landmarks
    order = order[thinned(index[order], _capacities(config).cluster_poses)][:room]
    row, slot, index = row[order], slot[order], index[order]
    keypoints = [k.features.keypoints for k in keyframes]
    pixels = np.stack([np.asarray(k.features.keypoints) for k in keypoints])[row, slot]
    depth, normals = (
        np.stack([np.asarray(getattr(k, name)) for k in keypoints])[row, slot]
        for name in ("depth", "normals")
    )
    padding = room - len(order)
    features = params.config.features
    correlation = np.sqrt(features.correlation)
    observations = RgbdReprojection(
        np.pad(row, (0, padding)),
        np.pad(index, (0, padding)),
        np.pad(pixels, ((0, padding), (0, 0))),
        np.pad(depth, (0, padding)),
        params.camera,
        sigma=float(params.noise.pixels) * correlation,
        inverse_depth_sigma=features.inverse_depth_sigma * correlation,
        valid=np.arange(room) < len(order),
        kernel="geman_mcclure",
        kernel_width=features.kernel_width,
    )
    return observations, numbers, np.pad(normals, ((0, padding), (0, 0)))


def _loose_prior(poses: Float[np.ndarray, "W 7"]) -> PosePrior:
    """Priors so weak that they matter only where there is nothing else."""
    return PosePrior(np.arange(len(poses)), jaxlie.SE3(jnp.asarray(poses)), jnp.eye(6) / _LOOSE**2)
