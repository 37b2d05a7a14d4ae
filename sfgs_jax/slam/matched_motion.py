"""Motion between two frames by their matched keypoints."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax import gicp
from sfgs_jax.geometry import Camera, kernel_weight, se3
from sfgs_jax.slam.config import FeaturesConfig
from sfgs_jax.slam.observation import Keypoints
from sfgs_jax.superfeats import match

_STEPS = 8
_NEAREST = 0.05
"""Metres along z below which a point has no image."""


class MatchedMotion(eqx.Module):
    """A motion with the matches that support it.

    Attributes:
        T_target_source: the motion.
        information: (6, 6) of its tangent (translation first, right perturbation), by the noise of pixels
            and of inverse depth.
        index: (K,) the target's slot for each slot of the source.
        inliers: (K,) the matches that the motion explains.
        num_matches: how many there were.
        num_inliers: how many of them are inliers.
    """

    T_target_source: jaxlie.SE3
    information: Float[Array, "6 6"]
    index: Int[Array, " k"]
    inliers: Bool[Array, " k"]
    num_matches: Int[Array, ""]
    num_inliers: Int[Array, ""]


class _Rows(NamedTuple):
    """Matched keypoints: the target's points, and what the source saw of them."""

    points: Float[Array, "k 3"]
    pixels: Float[Array, "k 2"]
    depth: Float[Array, " k"]
    valid: Bool[Array, " k"]


def motion_from_keypoints(
    source: Keypoints, target: Keypoints, guess: jaxlie.SE3, camera: Camera, config: FeaturesConfig
) -> MatchedMotion:
    """Match two frames' keypoints and find the motion between the frames.

    The motion starts from the guess, if that explains most of the matches; else from a rigid motion that lays
    the matched points on each other, by graduated non-convexity, if that explains more: it needs depth in
    both frames. Then the reprojection error of the target's points in the source, pixels and, where the
    source has it, inverse depth, is minimised by Gauss-Newton with a Geman-McClure kernel.

    Args:
        source: keypoints of the frame to locate, whose depth may be missing.
        target: keypoints with depth of the frame to locate it in.
        guess: the motion as it is thought to be.
        camera: intrinsics of both.
        config: settings.
    """
    slots = source.depth.shape[0]
    if slots == 0:
        # Features are switched off.
        nothing, none = jnp.zeros(0, jnp.int32), jnp.zeros((), jnp.int32)
        return MatchedMotion(guess, jnp.zeros((6, 6)), nothing, nothing > 0, none, none)
    matches = match(source.features, target.features, min_similarity=config.min_similarity)
    valid = matches.valid & target.measured[matches.index_b]
    rows = _Rows(target.points[matches.index_b], source.features.keypoints, source.depth, valid)

    num_matches = jnp.sum(valid, dtype=jnp.int32)
    guessed = _support(guess, rows, camera, config)

    def rigid() -> jaxlie.SE3:
        T = _rigid_motion(source, rows, matches.similarity, config)
        better = _support(T, rows, camera, config) > guessed
        return jaxlie.SE3(jnp.where(better, T.wxyz_xyz, guess.wxyz_xyz))

    # What explains most of the matches has no rival, and the refinement needs no better start.
    T = lax.cond(2 * guessed > num_matches, lambda: jaxlie.SE3(guess.wxyz_xyz), rigid)
    T, hessian = _refine(T, rows, camera, config)
    inliers = _explained(T, rows, camera, config, config.inlier_pixels)
    return MatchedMotion(
        T,
        hessian / config.correlation,
        matches.index_b,
        inliers,
        num_matches,
        jnp.sum(inliers, dtype=jnp.int32),
    )


def num_explained(
    T_target_source: jaxlie.SE3,
    matched: MatchedMotion,
    source: Keypoints,
    target: Keypoints,
    camera: Camera,
    config: FeaturesConfig,
) -> Int[Array, ""]:
    """How many of the inliers another motion explains too."""
    rows = _Rows(target.points[matched.index], source.features.keypoints, source.depth, matched.inliers)
    return jnp.sum(_explained(T_target_source, rows, camera, config, config.inlier_pixels), dtype=jnp.int32)


def _rigid_motion(
    source: Keypoints, rows: _Rows, similarity: Float[Array, " k"], config: FeaturesConfig
) -> jaxlie.SE3:
    """The motion that lays most of the best matches' points on each other."""
    best = jnp.where(rows.valid & (source.depth > 0), similarity, -1)
    similarity, order = lax.top_k(best, min(config.max_rigid_matches, len(best)))
    return gicp.rigid_from_matches(
        source.points[order],
        rows.points[order],
        1 / jnp.maximum(source.depth[order], 0.3) ** 2,
        valid=similarity > 0,
        max_distance=config.max_distance,
        refined=False,
    ).T_target_source


def _residuals(
    T: jaxlie.SE3, rows: _Rows, camera: Camera, config: FeaturesConfig
) -> tuple[Float[Array, "3 k"], Float[Array, "3 6 k"], Bool[Array, " k"]]:
    """Whitened residuals of T_target_source, their Jacobians in its tangent, and which rows have an image."""
    points = se3.transform(se3.inverse(T), rows.points).T
    x, y, z = points
    front = rows.valid & (z > _NEAREST)
    inverse = 1 / jnp.where(front, z, 1)
    a, b, zero = x * inverse, y * inverse, jnp.zeros_like(x)
    known = rows.depth > 0
    u, v = rows.pixels.T
    offsets = [
        (camera.fx * a + camera.cx - u) / config.pixel_sigma,
        (camera.fy * b + camera.cy - v) / config.pixel_sigma,
        jnp.where(known, inverse - 1 / jnp.where(known, rows.depth, 1), 0) / config.inverse_depth_sigma,
    ]
    slopes = [
        jnp.stack([camera.fx * inverse, zero, -camera.fx * a * inverse]) / config.pixel_sigma,
        jnp.stack([zero, camera.fy * inverse, -camera.fy * b * inverse]) / config.pixel_sigma,
        jnp.stack([zero, zero, jnp.where(known, -(inverse**2), 0)]) / config.inverse_depth_sigma,
    ]
    slope = jnp.stack(slopes)
    # A point of the target, in the source, moves by -d_translation + [p] d_rotation.
    jacobian = jnp.concatenate([-slope, jnp.cross(points[None], -slope, axis=1)], axis=1)
    return jnp.where(front, jnp.stack(offsets), 0), jnp.where(front, jacobian, 0), front


def _explained(
    T: jaxlie.SE3, rows: _Rows, camera: Camera, config: FeaturesConfig, pixels: float
) -> Bool[Array, " k"]:
    residual, _, front = _residuals(T, rows, camera, config)
    error = jnp.sum(residual[:2] ** 2, axis=0)
    near = jnp.abs(residual[2]) < config.inlier_depth_sigmas
    return front & near & (error < (pixels / config.pixel_sigma) ** 2)


def _support(T: jaxlie.SE3, rows: _Rows, camera: Camera, config: FeaturesConfig) -> Int[Array, ""]:
    """How many matches a motion that is yet to be refined explains."""
    return jnp.sum(_explained(T, rows, camera, config, 2 * config.inlier_pixels), dtype=jnp.int32)


def _refine(
    T: jaxlie.SE3, rows: _Rows, camera: Camera, config: FeaturesConfig
) -> tuple[jaxlie.SE3, Float[Array, "6 6"]]:
    """Iteratively reweighted Gauss-Newton; the Hessian at the end, divided by the residuals' excess."""

    def equations(T: jaxlie.SE3) -> tuple[Array, Array, Array, Array]:
        residual, jacobian, front = _residuals(T, rows, camera, config)
        square = jnp.sum(residual**2, axis=0)
        weight = jnp.where(front, kernel_weight(square, "geman_mcclure", config.kernel_width), 0)
        rows_of = jnp.moveaxis(jacobian, 1, 0).reshape(6, -1)
        weighted = jnp.moveaxis(weight * jacobian, 1, 0).reshape(6, -1)
        hessian, gradient = weighted @ rows_of.T, weighted @ residual.reshape(-1)
        return hessian, gradient, weight @ square, jnp.sum(weight)

    def step(_: Int[Array, ""], T: jaxlie.SE3) -> jaxlie.SE3:
        hessian, gradient, _, _ = equations(T)
        # Damped by its own diagonal, so that what no match fixes stays where it is.
        diagonal = jnp.diagonal(hessian)
        damped = hessian + jnp.diag(1e-4 * diagonal + 1e-3)
        delta = -jax.scipy.linalg.solve(damped, gradient, assume_a="pos")
        return se3.compose(T, se3.exp(jnp.clip(delta, -0.5, 0.5)))

    T = lax.fori_loop(0, _STEPS, step, T)
    hessian, _, square, weight = equations(T)
    # Three rows a match.
    excess = jnp.maximum(square / jnp.maximum(3 * weight, 1), 1)
    return T, hessian / excess
