"""Local bundle adjustment: the newest keyframes and their landmarks, optimised together."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Bool, Float

from sfgs_jax.factor_graph import (
    Capacities,
    FactorGraph,
    PosePrior,
    RgbdReprojection,
    Solution,
    SolverConfig,
    Status,
    Values,
    solve,
)
from sfgs_jax.geometry import se3
from sfgs_jax.slam.config import GraphConfig
from sfgs_jax.slam.keyframes._edges import relative_poses, systematic_variances
from sfgs_jax.slam.keyframes._landmarks import most_seen
from sfgs_jax.slam.state._keyframe_graph import KeyframeGraph
from sfgs_jax.slam.state._tracker import TrackerParams

_SOLVER = SolverConfig(max_iterations=15, cost_tolerance=1e-3)
"""The last thousandth of the cost takes half of the iterations and moves poses by tenths of a millimetre."""


class Window(eqx.Module):
    """The problem of a local bundle adjustment, padded to fixed shapes.

    Attributes:
        graph: reprojections of the landmarks, registrations between the keyframes, a prior on each pose.
        values: poses and landmarks to start from.
    """

    graph: FactorGraph
    values: Values


@jax.jit
def adjust(params: TrackerParams, window: Window) -> Solution:
    """Poses and landmarks of a window: GICP's registrations and reprojections in one Levenberg-Marquardt.

    A pure function on pytrees of fixed shapes, compiled once. SFGS-SLAM (Wang and Deng, 2025), section 3.3.

    Args:
        params: parameters of tracking; the camera's intrinsics are those of every reprojection.
        window: from `window_of`.
    """
    graph = eqx.tree_at(lambda g: _reprojections(g).camera, window.graph, params.camera)
    return solve(graph, window.values, config=_SOLVER)


def _reprojections(graph: FactorGraph) -> RgbdReprojection:
    return next(f for f in graph.factors if isinstance(f, RgbdReprojection))


def optimise_window(params: TrackerParams, graph: KeyframeGraph, config: GraphConfig) -> KeyframeGraph:
    """The graph with its newest keyframes' poses adjusted.

    Args:
        params: parameters of tracking.
        graph: before.
        config: settings.
    """
    if min(config.window, len(graph.keyframes)) < 2 or params.config.features.kind == "none":
        return graph
    solution = adjust(params, window_of(params, graph, config))
    if int(solution.status) in (Status.DIVERGED, Status.SINGULAR):
        return graph
    first = max(0, len(graph.keyframes) - config.window)
    found = np.asarray(solution.values.poses.wxyz_xyz)[: len(graph.keyframes) - first]
    return replace(graph, poses=np.concatenate([graph.poses[:first], found]))


def window_of(params: TrackerParams, graph: KeyframeGraph, config: GraphConfig) -> Window:
    """The window of the newest keyframes; its oldest pose is fixed.

    Args:
        params: parameters of tracking.
        graph: with at least two keyframes.
        config: settings.
    """
    size, first = config.window, max(0, len(graph.keyframes) - config.window)
    count = len(graph.keyframes) - first
    observations, points, measured = _observations(params, graph, config, first)
    poses = np.pad(graph.poses[first:], ((0, size - count), (0, 0)), mode="edge")
    room = size * (size - 1) // 2
    inside = [e for e in graph.edges if e.target >= first and not e.loop][-room:]
    registrations = relative_poses(
        inside,
        room,
        offsets=graph.offsets,
        first=first,
        surface_only=True,
        kernel="huber",
        kernel_width=config.kernel_width,
    )
    problem = FactorGraph(
        [observations, registrations, _priors(poses, config)],
        num_poses=size,
        num_landmarks=config.max_landmarks,
        free_poses=(np.arange(size) > 0) & (np.arange(size) < count),
        free_landmarks=measured,
        linear_solver="dense",
        capacities=Capacities.for_window(landmarks=config.max_landmarks, poses=size),
    )
    return Window(problem, Values(jaxlie.SE3(jnp.asarray(poses)), jnp.asarray(points)))


def _observations(
    params: TrackerParams, graph: KeyframeGraph, config: GraphConfig, first: int
) -> tuple[RgbdReprojection, Float[np.ndarray, "l 3"], Bool[np.ndarray, " l"]]:
    """Reprojections of the window's landmarks, where these start, and which have a measured depth."""
    size, members = config.window, graph.keyframes[first:]
    slots = len(members[0].landmarks)
    landmarks = np.full((size, slots), -1)
    pixels = np.zeros((size, slots, 2), np.float32)
    depth = np.zeros((size, slots), np.float32)
    for row, keyframe in enumerate(members):
        keypoints = keyframe.features.keypoints
        landmarks[row] = keyframe.landmarks
        pixels[row], depth[row] = keypoints.features.keypoints, keypoints.depth
    index, seen = most_seen(landmarks, config.max_landmarks)
    points = np.zeros((config.max_landmarks, 3), np.float32)
    cameras = se3.matrices_of(graph.poses[first:]).astype(np.float32)
    for row, keyframe in reversed(list(enumerate(members))):
        # A landmark starts where the first keyframe that measured its depth saw it.
        known = seen[row] & (depth[row] > 0)
        local = np.asarray(keyframe.features.keypoints.points)[known]
        points[index[row][known]] = local @ cameras[row, :3, :3].T + cameras[row, :3, 3]
    measured = np.zeros(config.max_landmarks, bool)
    measured[index[seen & (depth > 0)]] = True
    features = params.config.features
    correlation = np.sqrt(features.correlation)
    observations = RgbdReprojection(
        np.repeat(np.arange(size), slots),
        index.reshape(-1),
        pixels.reshape(-1, 2),
        depth.reshape(-1),
        params.camera,
        sigma=features.pixel_sigma * correlation,
        inverse_depth_sigma=features.inverse_depth_sigma * correlation,
        valid=(seen & measured[index]).reshape(-1),
        kernel="geman_mcclure",
        kernel_width=features.kernel_width,
    )
    return observations, points, measured


def _priors(poses: Float[np.ndarray, "w 7"], config: GraphConfig) -> PosePrior:
    """Priors at the poses of the pose graph, as firm as a registration's systematic error.

    The depth camera's distortion acts on the landmarks too, however many there are.
    """
    information = jnp.diag(jnp.asarray(1 / systematic_variances(config), jnp.float32))
    return PosePrior(np.arange(len(poses)), jaxlie.SE3(jnp.asarray(poses)), information)
