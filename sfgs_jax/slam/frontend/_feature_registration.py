"""Motion between two frames by their matched keypoints."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import jaxlie
from jax import lax
from jax.lax import Precision
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax import gicp
from sfgs_jax.geometry import Camera, kernel_weight, reprojection_residuals, se3
from sfgs_jax.sensors import carried, row_places
from sfgs_jax.slam.config import FeaturesConfig
from sfgs_jax.slam.state._frame_features import Keypoints
from sfgs_jax.slam.state._registration import FeatureRegistration
from sfgs_jax.slam.state._tracker import TrackerParams
from sfgs_jax.superfeats import Expected, Matches, match

_STEPS = 8


_CELLS = 8
"""Parts of the image's width, and of its height, that matches are counted by."""


class _Rows(NamedTuple):
    """Matched keypoints: the target's points, what the source saw of them, and weights, None if equal."""

    points: Float[Array, "k 3"]
    pixels: Float[Array, "k 2"]
    depth: Float[Array, " k"]
    valid: Bool[Array, " k"]
    sweep: gicp.Sweep | None
    weights: Float[Array, " k"] | None = None


def motion_from_keypoints(
    source: Keypoints,
    target: Keypoints,
    guess: jaxlie.SE3,
    params: TrackerParams,
    sweep: gicp.Sweep | None = None,
    *,
    guess_known: Bool[Array, ""] | bool = True,
) -> FeatureRegistration:
    """Match two frames' keypoints and find the motion between the frames.

    Of keypoints that look alike, those match that lie where the guess expects them. The motion starts from
    the guess if that explains most of the matches. Otherwise a rigid motion that lays the matched points on
    each other is tried, by graduated non-convexity; it needs depth in both frames. Then Gauss-Newton with a
    Geman-McClure kernel minimises the reprojection error of the target's points. That is an error of pixels
    and, where the source has depth, of inverse depth.

    The motion is differentiable by all iterations; with learned weights also with respect to descriptors and
    scores. Which keypoints match, and where the iterations start, has no derivative.

    Args:
        source: keypoints of the frame to locate, whose depth may be missing.
        target: keypoints with depth of the frame to locate it in.
        guess: the motion as it is thought to be.
        params: parameters of tracking.
        sweep: motion of the source while it was read; None where it stood still.
        guess_known: whether the guess says where keypoints should lie.
    """
    config, slots = params.config.features, source.depth.shape[0]
    if slots == 0:
        # Features are switched off.
        nothing, none = jnp.zeros(0, jnp.int32), jnp.zeros((), jnp.int32)
        return FeatureRegistration(guess, jnp.zeros((6, 6)), nothing, nothing > 0, none, none)
    matches = match(
        source.features,
        target.features,
        min_similarity=config.min_similarity,
        expected=_expected(target, guess, params.camera, config, guess_known),
    )
    valid = matches.valid & target.measured[matches.index_b]
    weights = _weights(source, target, matches, valid, config)
    rows = _Rows(
        target.points[matches.index_b], source.features.keypoints, source.depth, valid, sweep, weights
    )

    num_matches = jnp.sum(valid, dtype=jnp.int32)
    start = _guess_or_rigid_motion(guess, source, rows, matches.similarity, params)
    T, hessian = _refine(start, rows, params)
    inliers = _explained(T, rows, params, config.inlier_pixels)
    return FeatureRegistration(
        T,
        hessian / config.correlation,
        matches.index_b,
        inliers,
        num_matches,
        jnp.sum(inliers, dtype=jnp.int32),
    )


def num_explained(
    T_target_source: jaxlie.SE3,
    matched: FeatureRegistration,
    source: Keypoints,
    target: Keypoints,
    params: TrackerParams,
    sweep: gicp.Sweep | None = None,
) -> Int[Array, ""]:
    """Inliers that another motion explains too, counted."""
    points, seen = target.points[matched.index], source.features.keypoints
    rows = _Rows(points, seen, source.depth, matched.inliers, sweep)
    pixels = params.config.features.inlier_pixels
    return jnp.sum(_explained(T_target_source, rows, params, pixels), dtype=jnp.int32)


def _guess_or_rigid_motion(
    guess: jaxlie.SE3,
    source: Keypoints,
    rows: _Rows,
    similarity: Float[Array, " k"],
    params: TrackerParams,
) -> jaxlie.SE3:
    """The guess if it explains most of the matches, else it or a rigid motion, whichever explains more."""
    shares = _shares(rows, params.camera)
    guessed = _support(guess, rows, shares, params)

    def rigid() -> jaxlie.SE3:
        T = _rigid_motion(source, rows, similarity, params.config.features)
        better = _support(T, rows, shares, params) > guessed
        return jaxlie.SE3(jnp.where(better, T.wxyz_xyz, guess.wxyz_xyz))

    # A guess that explains most of the matches has no rival, and is a good enough start.
    return lax.cond(2 * guessed > jnp.sum(shares), lambda: jaxlie.SE3(guess.wxyz_xyz), rigid)


def _expected(
    target: Keypoints,
    guess: jaxlie.SE3,
    camera: Camera,
    config: FeaturesConfig,
    guess_known: Bool[Array, ""] | bool,
) -> Expected | None:
    """Where the guess brings the target's keypoints in the source's image."""
    if config.guidance == 0:
        return None
    points = se3.transform(se3.inverse(guess), jnp.where(target.measured[:, None], target.points, 0))
    seen = target.measured & (points[:, 2] > 0)
    # What has no image there is expected nowhere.
    pixels = jnp.where(seen[:, None], camera.project(points), jnp.inf)
    penalty = jnp.where(jnp.asarray(guess_known), jnp.asarray(config.guidance, pixels.dtype), 0)
    return Expected(pixels, config.guidance_reach * camera.width, penalty)


def _weights(
    source: Keypoints, target: Keypoints, matches: Matches, valid: Bool[Array, " k"], config: FeaturesConfig
) -> Float[Array, " k"] | None:
    """Weights of the matches, with a mean of 1, so that they say nothing about the noise of all of them."""
    if config.match_weights == "equal":
        return None
    # At the floor a match weighs nothing: one that comes or goes there moves no pose.
    certain = jnp.where(valid, matches.similarity - config.min_similarity, 0)
    weights = certain * source.features.scores * target.features.scores[matches.index_b]
    mean = jnp.sum(weights) / jnp.maximum(jnp.sum(valid.astype(weights.dtype)), 1)
    return weights / jnp.where(mean > 0, mean, 1)


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
    T: jaxlie.SE3, rows: _Rows, params: TrackerParams
) -> tuple[Float[Array, "3 k"], Float[Array, "3 6 k"], Bool[Array, " k"]]:
    """Whitened residuals of T_target_source, their Jacobians in its tangent, and which rows have an image."""
    # Rows that are not valid may hold anything: they go to where nothing has an image.
    points = jnp.where(rows.valid, se3.transform(se3.inverse(T), rows.points).T, 0)
    if rows.sweep is not None:
        moving = rows.sweep.at(T)
        times = moving.timing.colour_times(row_places(rows.pixels[:, 1], params.camera.height))
        # The Jacobian leaves out that the twist turns with T: it says where to step, not where to end.
        points = carried(points, moving.twist, -times)
    found = reprojection_residuals(
        params.camera,
        points,
        rows.pixels.T,
        rows.depth,
        sigma=params.noise.pixels,
        inverse_depth_sigma=params.noise.inverse_depth,
    )
    return found.residual, found.pose_jacobian, found.has_image


def _explained(T: jaxlie.SE3, rows: _Rows, params: TrackerParams, pixels: float) -> Bool[Array, " k"]:
    residual, _, front = _residuals(T, rows, params)
    error = jnp.sum(residual[:2] ** 2, axis=0)
    near = jnp.abs(residual[2]) < params.config.features.inlier_depth_sigmas
    return front & near & (error < (pixels / params.noise.pixels) ** 2)


def _shares(rows: _Rows, camera: Camera) -> Float[Array, " k"]:
    """Part of each match in its cell of the image; all matches of a cell make 1 together.

    A thing that moves by itself may be small and still hold most of the keypoints.
    """
    u, v = rows.pixels.T
    column, row = (
        jnp.clip((_CELLS / side * place).astype(jnp.int32), 0, _CELLS - 1)
        for place, side in ((u, camera.width), (v, camera.height))
    )
    cell = jnp.where(rows.valid, row * _CELLS + column, _CELLS**2)
    counts = jnp.zeros(_CELLS**2 + 1, rows.pixels.dtype).at[cell].add(1)
    return jnp.where(rows.valid, 1 / counts[cell], 0)


def _support(
    T: jaxlie.SE3, rows: _Rows, shares: Float[Array, " k"], params: TrackerParams
) -> Float[Array, ""]:
    """Cells of the image that an unrefined motion explains."""
    pixels = 2 * params.config.features.inlier_pixels
    return jnp.sum(jnp.where(_explained(T, rows, params, pixels), shares, 0))


def _refine(T: jaxlie.SE3, rows: _Rows, params: TrackerParams) -> tuple[jaxlie.SE3, Float[Array, "6 6"]]:
    """Iteratively reweighted Gauss-Newton; the Hessian at the end, divided by the residuals' excess."""

    def equations(T: jaxlie.SE3) -> tuple[Array, Array, Array, Array]:
        residual, jacobian, front = _residuals(T, rows, params)
        square, width = jnp.sum(residual**2, axis=0), params.config.features.kernel_width
        weight = jnp.where(front, kernel_weight(square, "geman_mcclure", width), 0)
        weight = weight if rows.weights is None else weight * rows.weights
        rows_of = jnp.moveaxis(jacobian, 1, 0).reshape(6, -1)
        weighted = jnp.moveaxis(weight[None, None] * jacobian, 1, 0).reshape(6, -1)
        hessian = jnp.matmul(weighted, rows_of.T, precision=Precision.HIGHEST)
        gradient = jnp.matmul(weighted, residual.reshape(-1), precision=Precision.HIGHEST)
        return hessian, gradient, jnp.sum(weight * square), jnp.sum(weight)

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
