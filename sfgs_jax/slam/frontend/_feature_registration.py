"""Motion between two frames by their matched keypoints."""

import equinox as eqx
import jax.numpy as jnp
import jaxlie
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax import gicp
from sfgs_jax.geometry import Camera, se3
from sfgs_jax.slam.config import FeaturesConfig
from sfgs_jax.slam.frontend._aligned_matches import with_aligned_places
from sfgs_jax.slam.frontend._least_reprojection import (
    MatchedRows,
    information,
    least_reprojection,
    newton_corrected,
    row_residuals,
)
from sfgs_jax.slam.frontend._rectification import with_depth_in_time
from sfgs_jax.slam.state._frame_features import FrameFeatures, Keypoints
from sfgs_jax.slam.state._registration import FeatureRegistration
from sfgs_jax.slam.state._tracker import TrackerParams
from sfgs_jax.superfeats import Expected, Matches, match

_CELLS = 8
"""Parts of the image's width, and of its height, that matches are counted by."""


def motion_from_keypoints(
    source: FrameFeatures,
    target: FrameFeatures,
    guess: jaxlie.SE3,
    params: TrackerParams,
    sweep: gicp.Sweep | None = None,
    *,
    guess_known: Bool[Array, ""] | bool = True,
) -> FeatureRegistration:
    """Match two frames' keypoints and find the motion between the frames.

    Keypoints that look alike match if they lie where the guess expects them. The motion starts from the guess
    if that explains most of the matches. Otherwise a rigid motion that lays the matched points on
    each other is tried, by graduated non-convexity; it needs depth in both frames. Then Gauss-Newton with a
    Geman-McClure kernel minimises the reprojection error of the target's points. That is an error of pixels
    and, where the source has depth, of inverse depth. With `FeaturesConfig.align_patches` that motion lays
    the target's patches over the source's. Matches get the places at which they look alike, and those that
    don't are left out. The motion is found anew.

    The motion is differentiable by the implicit function theorem; with learned weights also with respect to
    descriptors and scores. Which keypoints match, and where the iterations start, has no derivative.

    Args:
        source: the frame to locate, as it was read if it has a sweep; the depth of its keypoints may be
            missing.
        target: the frame to locate it in, by its keypoints with depth.
        guess: the motion as it is thought to be.
        params: parameters of tracking.
        sweep: motion of the source while it was read; None where it stood still.
        guess_known: whether the guess says where keypoints should lie.
    """
    config = params.config.features
    if source.keypoints.depth.shape[0] == 0:
        # Features are switched off.
        nothing, none = jnp.zeros(0, jnp.int32), jnp.zeros((), jnp.int32)
        return FeatureRegistration(
            guess, jnp.zeros((6, 6)), nothing, nothing > 0, none, none, jnp.zeros((0, 2)), guess
        )
    seen = keypoints_in_time(source, params, sweep, guess)
    matches, rows = _matched_rows(seen, target.keypoints, guess, params, sweep, guess_known)
    start = _guess_or_rigid_motion(guess, seen, rows, matches.similarity, params)
    T = as_detected = least_reprojection(start, rows, params)
    if config.align_patches:
        rows = with_aligned_places(T, rows, matches, source, target, params)
        rows = rows._replace(depth=keypoints_in_time(source, params, sweep, T).depth)
        T = least_reprojection(T, rows, params)
    inliers = _explained(T, rows, params, config.inlier_pixels)
    return FeatureRegistration(
        T,
        information(T, rows, params),
        matches.index_b,
        inliers,
        num_matches=jnp.sum(rows.valid, dtype=jnp.int32),
        num_inliers=jnp.sum(inliers, dtype=jnp.int32),
        pixels=rows.pixels,
        T_as_detected=as_detected,
    )


def with_derivatives(
    source: FrameFeatures,
    target: FrameFeatures,
    guess: jaxlie.SE3,
    params: TrackerParams,
    sweep: gicp.Sweep | None,
    found: FeatureRegistration,
) -> FeatureRegistration:
    """A result of `motion_from_keypoints` with its derivatives, without the steps that led there.

    Args:
        source: as of `motion_from_keypoints`, like the other arguments.
        target: the same.
        guess: the same.
        params: the same.
        sweep: the same.
        found: the result, without derivatives.
    """
    if source.keypoints.depth.shape[0] == 0:
        return found
    seen = keypoints_in_time(source, params, sweep, guess)
    matches, rows = _matched_rows(seen, target.keypoints, guess, params, sweep, True)
    T = as_detected = newton_corrected(found.T_as_detected, rows, params)
    if params.config.features.align_patches:
        rows = with_aligned_places(T, rows, matches, source, target, params, found.pixels)
        rows = rows._replace(depth=keypoints_in_time(source, params, sweep, T).depth)
        T = newton_corrected(found.T_target_source, rows, params)
    return eqx.tree_at(
        lambda f: (f.T_target_source, f.information, f.pixels, f.T_as_detected),
        found,
        (T, information(T, rows, params), rows.pixels, as_detected),
    )


def keypoints_in_time(
    source: FrameFeatures,
    params: TrackerParams,
    sweep: gicp.Sweep | None,
    T_target_source: jaxlie.SE3,
) -> Keypoints:
    """Keypoints of a frame with the depth that their surfaces had when their pixels were read.

    Args:
        source: the frame, as it was read if it has a sweep.
        params: parameters of tracking.
        sweep: as of `motion_from_keypoints`.
        T_target_source: the motion that says how the camera moved.
    """
    if sweep is None:
        return source.keypoints
    return with_depth_in_time(source, params.camera, sweep.at(T_target_source))


def _matched_rows(
    source: Keypoints,
    target: Keypoints,
    guess: jaxlie.SE3,
    params: TrackerParams,
    sweep: gicp.Sweep | None,
    guess_known: Bool[Array, ""] | bool,
) -> tuple[Matches, MatchedRows]:
    config = params.config.features
    matches = match(
        source.features,
        target.features,
        min_similarity=config.min_similarity,
        expected=_expected(target, guess, params.camera, config, guess_known),
    )
    valid = matches.valid & target.measured[matches.index_b]
    weights = _weights(source, target, matches, valid, config)
    points, pixels = target.points[matches.index_b], source.features.keypoints
    return matches, MatchedRows(points, pixels, source.depth, valid, sweep, weights)


def num_explained(
    T_target_source: jaxlie.SE3,
    matched: FeatureRegistration,
    source: Keypoints,
    target: Keypoints,
    params: TrackerParams,
    sweep: gicp.Sweep | None = None,
) -> Int[Array, ""]:
    """Inliers that another motion explains too, counted."""
    points = target.points[matched.index]
    rows = MatchedRows(points, matched.pixels, source.depth, matched.inliers, sweep)
    pixels = params.config.features.inlier_pixels
    return jnp.sum(_explained(T_target_source, rows, params, pixels), dtype=jnp.int32)


def _guess_or_rigid_motion(
    guess: jaxlie.SE3,
    source: Keypoints,
    rows: MatchedRows,
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
    source: Keypoints, rows: MatchedRows, similarity: Float[Array, " k"], config: FeaturesConfig
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


def _explained(T: jaxlie.SE3, rows: MatchedRows, params: TrackerParams, pixels: float) -> Bool[Array, " k"]:
    residual, _, front = row_residuals(T, rows, params)
    error = jnp.sum(residual[:2] ** 2, axis=0)
    near = jnp.abs(residual[2]) < params.config.features.inlier_depth_sigmas
    return front & near & (error < (pixels / params.noise.pixels) ** 2)


def _shares(rows: MatchedRows, camera: Camera) -> Float[Array, " k"]:
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
    T: jaxlie.SE3, rows: MatchedRows, shares: Float[Array, " k"], params: TrackerParams
) -> Float[Array, ""]:
    """Cells of the image that an unrefined motion explains."""
    pixels = 2 * params.config.features.inlier_pixels
    return jnp.sum(jnp.where(_explained(T, rows, params, pixels), shares, 0))
