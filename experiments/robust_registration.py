"""Registration of two frames whose robustness is an input: kernel widths and weights have derivatives.

The library's settings are static. Here the same residuals make a factor graph, whose kernel widths and noise
are arrays, and `factor_graph.solve_implicit` differentiates its optimum. Keypoints have reprojection errors
under a Geman-McClure kernel. Surface has distances along normals under a Huber kernel. The motion as it was
expected is a prior. Correspondences of the surface are found anew in rounds, and matches once.
"""

from dataclasses import fields
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Float

from sfgs_jax import factor_graph, slam
from sfgs_jax.geometry import Camera, Frame, se3, surface
from sfgs_jax.superfeats import match

TRACKING = slam.TrackingConfig()
STRIDE = 2
"""Pixels from one point of the surface to the next."""
REDUNDANCY = ((2 * TRACKING.gicp.radius + 1) / STRIDE) ** 2
"""Neighbouring planes share most of the pixels that they were fitted to."""
ROUNDS = 8
NEVER = 1e4
"""Standard deviations that make a row without measurement weigh nothing."""
REACH = 2.0
"""Distance of the points whose displacement sums up an error of a pose, metres."""


class Robustness(eqx.Module):
    """Logarithms of the numbers that bound the influence of wrong measurements.

    Attributes:
        keypoint_width: of the kernel of the matches, standard deviations.
        surface_width: of the kernel of the surface, standard deviations.
        correlation: matches that share one independent error.
        motion_sigma: of the expected motion, metres and radians.
    """

    keypoint_width: Float[Array, ""]
    surface_width: Float[Array, ""]
    correlation: Float[Array, ""]
    motion_sigma: Float[Array, ""]


NAMES = tuple(field.name for field in fields(Robustness))


def by_hand() -> Robustness:
    """The library's settings."""
    features, gicp = TRACKING.features, TRACKING.gicp
    numbers = (features.kernel_width, gicp.kernel_width, features.correlation, TRACKING.motion_model_sigma)
    return Robustness(*(jnp.log(jnp.float32(x)) for x in numbers))


class FramePair(NamedTuple):
    """Two frames of one camera as their registration needs them.

    Attributes:
        camera: intrinsics of both.
        points, normals: (N, 3) surface of the source; zeros where there is none.
        target: (H, W, 6) surface points and normals of the target.
        pixels, depth: (K, 2) and (K,) keypoints of the source; depth 0 is missing.
        landmarks: (K, 3) their counterparts in the target.
        matched: (K,) 1 for those that have one, else 0.
        guess: `T_target_source` as it is expected, wxyz_xyz.
        truth: as it is.
    """

    camera: Camera
    points: Float[Array, "N 3"]
    normals: Float[Array, "N 3"]
    target: Float[Array, "H W 6"]
    pixels: Float[Array, "K 2"]
    depth: Float[Array, " K"]
    landmarks: Float[Array, "K 3"]
    matched: Float[Array, " K"]
    guess: Float[Array, "7"]
    truth: Float[Array, "7"]


def frame_pair(
    params: slam.TrackerParams,
    source: Frame,
    target: Frame,
    truth: Float[np.ndarray, "4 4"],
    off: Float[np.ndarray, "6"],
) -> FramePair:
    """Two frames prepared for registration.

    Args:
        params: of tracking, with the keypoints' settings.
        source: the frame to locate.
        target: the frame to locate it in.
        truth: `T_target_source`.
        off: error of the expected motion, a tangent.
    """
    camera = params.camera
    a, b = (slam.observe(params, frame).keypoints for frame in (source, target))
    matches = match(a.features, b.features, min_similarity=params.config.features.min_similarity)
    matched = matches.valid & b.measured[matches.index_b]
    found, seen = surface(source.depth, camera), surface(target.depth, camera)
    part = (slice(None, None, STRIDE),) * 2
    landmarks = jnp.where(matched[:, None], b.points[matches.index_b], jnp.asarray([[0.0, 0.0, 1.0]]))
    T = se3.from_matrix(truth)
    return FramePair(
        camera=camera,
        points=found.points[part].reshape(-1, 3),
        normals=found.normals[part].reshape(-1, 3),
        target=jnp.concatenate([seen.points, seen.normals], axis=2),
        pixels=a.features.keypoints,
        depth=a.depth,
        landmarks=landmarks,
        matched=matched.astype(jnp.float32),
        guess=se3.compose(T, se3.exp(jnp.asarray(off, jnp.float32))).wxyz_xyz,
        truth=T.wxyz_xyz,
    )


def registered(robustness: Robustness, pair: FramePair, rounds: int = ROUNDS) -> Float[Array, "7"]:
    """`T_target_source` of a pair as wxyz_xyz, differentiable by the robustness.

    Args:
        robustness: logarithms of widths and weights.
        pair: the frames.
        rounds: searches for correspondences; only the last optimum has a derivative.
    """
    held = jax.lax.stop_gradient(robustness)
    T = jax.lax.fori_loop(0, rounds - 1, lambda _, T: _optimum(held, pair, T), pair.guess)
    return _optimum(robustness, pair, jax.lax.stop_gradient(T))


def _optimum(robustness: Robustness, pair: FramePair, T: Float[Array, "7"]) -> Float[Array, "7"]:
    """The motion that fits best, with the surface's correspondences of a motion near it."""
    start = factor_graph.Values(jaxlie.SE3(jnp.stack([se3.identity().wxyz_xyz, T])), pair.landmarks)
    return factor_graph.solve_implicit(_graph(robustness, pair, T), start).poses.wxyz_xyz[1]


def _graph(robustness: Robustness, pair: FramePair, T: Float[Array, "7"]) -> factor_graph.FactorGraph:
    """Factors on the source's pose, 1, in the target's, 0, which is held."""
    features, count = TRACKING.features, len(pair.matched)
    weight = jnp.exp(-robustness.correlation)
    sigma = jnp.where(pair.matched > 0, 1, NEVER)
    kernel = jnp.exp(robustness.keypoint_width)
    keypoints = factor_graph.RgbdReprojection(
        np.ones(count, np.int32),
        np.arange(count),
        pair.pixels,
        pair.depth,
        pair.camera,
        sigma=features.pixel_sigma * sigma,
        inverse_depth_sigma=features.inverse_depth_sigma * sigma,
        kernel="geman_mcclure",
        kernel_width=kernel,
    )
    expected = factor_graph.PosePrior(
        np.asarray([1]),
        jaxlie.SE3(pair.guess[None]),
        jnp.eye(6) * jnp.exp(-2 * robustness.motion_sigma) / weight,
    )
    return factor_graph.FactorGraph(
        [keypoints, _surface_factors(robustness, pair, T, weight), expected],
        num_poses=2,
        num_landmarks=count,
        free_poses=np.asarray([False, True]),
        free_landmarks=np.zeros(count, bool),
    )


def _surface_factors(
    robustness: Robustness, pair: FramePair, T: Float[Array, "7"], weight: Float[Array, ""]
) -> factor_graph.DirectGicp:
    """Distances along the target's normals at the pixels where the source's points fall.

    The whole problem is divided by the weight of the keypoints. That leaves their kernel alone.
    """
    gicp = TRACKING.gicp
    moved = se3.transform(jaxlie.SE3(T), pair.points)
    normals = pair.normals @ se3.rotation_matrix(jaxlie.SE3(T)).T
    front = moved[:, 2] > 0.1
    pixels = pair.camera.project(jnp.where(front[:, None], moved, jnp.asarray([[0.0, 0.0, 1.0]])))
    last = jnp.asarray([[pair.camera.width - 1.0, pair.camera.height - 1.0]])
    at = jnp.clip(jnp.round(pixels), 0, last)
    inside = front & jnp.all(jnp.abs(at - pixels) <= 0.5, axis=1)
    met = pair.target[at[:, 1].astype(jnp.int32), at[:, 0].astype(jnp.int32)]
    near = jnp.sum((met[:, :3] - moved) ** 2, axis=1) < gicp.max_distance[0] ** 2
    alike = jnp.sum(met[:, 3:] * normals, axis=1) > gicp.min_normal_cosine[0]
    sigma = gicp.noise + gicp.noise_per_square_metre * pair.points[:, 2] ** 2
    variance = sigma**2 * REDUNDANCY * weight
    return factor_graph.DirectGicp(
        (0, 1),
        pair.points,
        met[:, :3],
        normals=met[:, 3:],
        weights=jnp.where(inside & near & alike, 1 / variance, 0),
        kernel="huber",
        kernel_width=jnp.exp(robustness.surface_width) * jax.lax.rsqrt(REDUNDANCY * weight),
    )


def error(robustness: Robustness, pair: FramePair) -> Float[Array, ""]:
    """Displacement of points `REACH` away by the error of the motion, metres, root mean square."""
    T = jaxlie.SE3(registered(robustness, pair))
    off = se3.log(se3.compose(se3.inverse(jaxlie.SE3(pair.truth)), T))
    return jnp.sqrt(jnp.sum(off[:3] ** 2) + 2 / 3 * REACH**2 * jnp.sum(off[3:] ** 2) + 1e-12)


@jax.jit
def errors(robustness: Robustness, pairs: FramePair) -> Float[Array, " n"]:
    """Errors of stacked pairs, metres."""
    return jax.lax.map(partial(error, robustness), pairs)


@jax.jit
def loss_and_slope(robustness: Robustness, pairs: FramePair) -> tuple[Float[Array, ""], Robustness]:
    """Mean logarithm of the errors of stacked pairs, and its gradient by the robustness."""

    def one(pair: FramePair) -> tuple[Array, Robustness]:
        return jax.value_and_grad(lambda r: jnp.log(error(r, pair) + 1e-3))(robustness)

    return jax.tree.map(lambda x: jnp.mean(x, axis=0), jax.lax.map(one, pairs))
