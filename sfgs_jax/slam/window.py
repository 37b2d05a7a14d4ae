"""The window: the newest keyframes with the landmarks they see, optimised together."""

from dataclasses import replace

import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Bool, Int

from sfgs_jax.factor_graph import (
    Capacities,
    FactorGraph,
    PosePrior,
    RelativePose,
    RgbdReprojection,
    SolverConfig,
    Status,
    Values,
    solve,
)
from sfgs_jax.factor_graph.structure import CLUSTER_LANDMARKS
from sfgs_jax.geometry import se3
from sfgs_jax.slam.config import GraphConfig
from sfgs_jax.slam.graph import relative_poses, with_poses
from sfgs_jax.slam.nodes import Edge
from sfgs_jax.slam.registration import Registration
from sfgs_jax.slam.state import SlamState

_KERNEL_WIDTH = 3.0
"""Of the Huber kernel of a registration, standard deviations."""
_SOLVER = SolverConfig(max_iterations=15, cost_tolerance=1e-3)
"""The last thousandth of the cost takes half of the iterations and moves poses by tenths of a millimetre."""


def share_landmarks(state: SlamState, target: int, source: int, found: Registration) -> SlamState:
    """The state in which the matched keypoints of two keyframes show the same landmarks.

    A keypoint of either that shows a landmark already hands it on; others start one.
    """
    # Lists and sets, not arrays: what is looked up one by one is found in a fraction of the time.
    a, b = (state.keyframes[i].landmarks.tolist() for i in (target, source))
    in_a, in_b = set(a), set(b)
    slots_b = np.flatnonzero(np.asarray(found.matched.inliers))
    slots_a = np.asarray(found.matched.index)[slots_b]
    number = state.num_landmarks
    # One landmark has one place in an image.
    for slot_a, slot_b in zip(slots_a.tolist(), slots_b.tolist(), strict=True):
        if b[slot_b] >= 0:
            if a[slot_a] < 0 and b[slot_b] not in in_a:
                a[slot_a] = b[slot_b]
                in_a.add(a[slot_a])
            continue
        if a[slot_a] < 0:
            a[slot_a] = number
            in_a.add(number)
            number += 1
        if a[slot_a] not in in_b:
            b[slot_b] = a[slot_a]
            in_b.add(b[slot_b])
    keyframes = list(state.keyframes)
    keyframes[target] = replace(keyframes[target], landmarks=np.asarray(a, int))
    keyframes[source] = replace(keyframes[source], landmarks=np.asarray(b, int))
    return replace(state, keyframes=tuple(keyframes), num_landmarks=number)


def optimise_window(state: SlamState) -> SlamState:
    """Poses of the newest keyframes and the landmarks they see, by everything known of these.

    GICP's registrations among them, pixels and depths of the landmarks, and for each pose a prior that ties
    it to the rest of the graph; the oldest pose is fixed. SFGS-SLAM (Wang and Deng, 2025), section 3.3.
    """
    config = state.config
    size = config.graph.window
    first = max(0, len(state.keyframes) - size)
    members = state.keyframes[first:]
    if len(members) < 2 or config.tracking.features.kind == "none":
        return state
    slots = len(members[0].landmarks)
    landmarks = np.full((size, slots), -1)
    pixels = np.zeros((size, slots, 2), np.float32)
    depth = np.zeros((size, slots), np.float32)
    points = np.zeros((config.graph.max_landmarks, 3), np.float32)
    for row, keyframe in enumerate(members):
        keypoints = keyframe.observation.keypoints
        landmarks[row] = keyframe.landmarks
        pixels[row], depth[row] = keypoints.features.keypoints, keypoints.depth
    index, seen = _compressed(landmarks, config.graph.max_landmarks)
    cameras = se3.matrices_of(state.keyframe_poses[first:]).astype(np.float32)
    for row, keyframe in reversed(list(enumerate(members))):
        # A landmark starts where the first keyframe that measured its depth saw it.
        known = seen[row] & (depth[row] > 0)
        local = np.asarray(keyframe.observation.keypoints.points)[known]
        points[index[row][known]] = local @ cameras[row, :3, :3].T + cameras[row, :3, 3]
    measured = np.zeros(config.graph.max_landmarks, bool)
    measured[index[seen & (depth > 0)]] = True
    seen &= measured[index]

    poses = np.pad(state.keyframe_poses[first:], ((0, size - len(members)), (0, 0)), mode="edge")
    features = config.tracking.features
    correlation = np.sqrt(features.correlation)
    observations = RgbdReprojection(
        np.repeat(np.arange(size), slots),
        index.reshape(-1),
        pixels.reshape(-1, 2),
        depth.reshape(-1),
        state.camera,
        sigma=features.pixel_sigma * correlation,
        inverse_depth_sigma=features.inverse_depth_sigma * correlation,
        valid=seen.reshape(-1),
        kernel="geman_mcclure",
        kernel_width=features.kernel_width,
    )
    free = (np.arange(size) > 0) & (np.arange(size) < len(members))
    graph = FactorGraph(
        [observations, _registrations(state.edges, first, size), _priors(poses, config.graph)],
        num_poses=size,
        num_landmarks=config.graph.max_landmarks,
        free_poses=free,
        free_landmarks=measured,
        linear_solver="dense",
        capacities=Capacities(
            clusters=-(-config.graph.max_landmarks // CLUSTER_LANDMARKS), cluster_poses=size
        ),
    )
    solution = solve(graph, Values(jaxlie.SE3(jnp.asarray(poses)), jnp.asarray(points)), config=_SOLVER)
    if int(solution.status) in (Status.DIVERGED, Status.SINGULAR):
        return state
    found = np.asarray(solution.values.poses.wxyz_xyz)[: len(members)]
    return with_poses(state, np.concatenate([state.keyframe_poses[:first], found]))


def _compressed(
    landmarks: Int[np.ndarray, "w k"], capacity: int
) -> tuple[Int[np.ndarray, "w k"], Bool[np.ndarray, "w k"]]:
    """Numbers of the landmarks seen at least twice, counted from 0, and which slots show one of these."""
    numbers, inverse, counts = np.unique(landmarks, return_inverse=True, return_counts=True)
    counts[numbers < 0] = 0
    kept = np.argsort(-counts, kind="stable")[:capacity]
    kept = kept[counts[kept] > 1]
    place = np.full(len(numbers), -1, np.int32)
    place[kept] = np.arange(len(kept))
    index = place[inverse].reshape(landmarks.shape)
    return np.maximum(index, 0), index >= 0


def _registrations(edges: tuple[Edge, ...], first: int, size: int) -> RelativePose:
    """The surfaces' part of the registrations within the window."""
    room = size * (size - 1) // 2
    inside = [e for e in edges if e.target >= first and not e.loop][-room:]
    local = [
        replace(e, target=e.target - first, source=e.source - first, information=e.surface_information)
        for e in inside
    ]
    return relative_poses(local, room, kernel="huber", kernel_width=_KERNEL_WIDTH)


def _priors(poses: np.ndarray, config: GraphConfig) -> PosePrior:
    """Where the rest of the graph has the poses, as firmly as a registration without noise would.

    What the depth camera distorts, it distorts for the landmarks too, however many there are.
    """
    sigmas = np.repeat([config.edge_sigma_metres, config.edge_sigma_radians], 3)
    information = jnp.diag(jnp.asarray(1 / sigmas**2, jnp.float32))
    return PosePrior(np.arange(len(poses)), jaxlie.SE3(jnp.asarray(poses)), information)
