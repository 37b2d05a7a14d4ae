"""Motion between two frames by their matched keypoints."""

from dataclasses import replace
from typing import NamedTuple

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
from sfgs_jax.superfeats import Expected, match

_MOST = 512
"""Matches that count, those that look most alike."""
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
    each other is tried, by graduated non-convexity; it needs depth in both frames. Then Newton's method
    minimises the reprojection error of the target's points, under a Geman-McClure kernel. That is an error of
    pixels and, where the source has depth, of inverse depth. With `FeaturesConfig.align_patches` that
    motion lays the target's patches over the source's. Matches get the places at which they look alike, and
    those that don't are left out. The motion is found anew.

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
            guess, jnp.zeros((6, 6)), nothing, nothing > 0, none, none, none, jnp.zeros((0, 2)), guess
        )
    matched = _matched(source, target, guess, params, sweep, guess_known)
    rows = matched.rows
    start = _guess_or_rigid_motion(guess, matched, params)
    T = as_detected = least_reprojection(start, rows, params)
    if config.align_patches:
        rows = with_aligned_places(T, rows, matched.source, matched.target, params)
        rows = rows._replace(depth=keypoints_in_time(matched.source, params, sweep, T).depth)
        T = least_reprojection(T, rows, params)
    inliers = _explained(T, rows, params, config.inlier_pixels)
    pixels = source.keypoints.features.keypoints
    return FeatureRegistration(
        T,
        information(T, rows, params),
        matched.to,
        jnp.zeros(len(pixels), bool).at[matched.slots].set(inliers),
        num_detected=jnp.sum(matched.rows.valid, dtype=jnp.int32),
        num_matches=jnp.sum(rows.valid, dtype=jnp.int32),
        num_inliers=jnp.sum(inliers, dtype=jnp.int32),
        pixels=pixels.at[matched.slots].set(rows.pixels),
        T_as_detected=as_detected,
    )


def with_derivatives(
    source: FrameFeatures,
    target: FrameFeatures,
    guess: jaxlie.SE3,
    params: TrackerParams,
    sweep: gicp.Sweep | None,
    found: FeatureRegistration,
    *,
    guess_known: Bool[Array, ""] | bool,
) -> FeatureRegistration:
    """A result of `motion_from_keypoints` with its derivatives, without the steps that led there.

    Args:
        source: as of `motion_from_keypoints`, like the other arguments.
        target: the same.
        guess: the same.
        params: the same.
        sweep: the same.
        found: the result, without derivatives.
        guess_known: as of `motion_from_keypoints`.
    """
    if source.keypoints.depth.shape[0] == 0:
        return found
    matched = _matched(source, target, guess, params, sweep, guess_known)
    rows, slots = matched.rows, matched.slots
    T = as_detected = newton_corrected(found.T_as_detected, rows, params)
    if params.config.features.align_patches:
        rows = with_aligned_places(T, rows, matched.source, matched.target, params, found.pixels[slots])
        rows = rows._replace(depth=keypoints_in_time(matched.source, params, sweep, T).depth)
        T = newton_corrected(found.T_target_source, rows, params)
    pixels = source.keypoints.features.keypoints.at[slots].set(rows.pixels)
    return eqx.tree_at(
        lambda f: (f.T_target_source, f.information, f.pixels, f.T_as_detected),
        found,
        (T, information(T, rows, params), pixels, as_detected),
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


class _Matched(NamedTuple):
    """The matches that count.

    Attributes:
        to: (K,) the target's slot for each slot of the source, matched or not.
        slots: (M,) the source's slots of those that count.
        source: the source with their keypoints alone, in the order of `slots`, as it was read.
        target: the target with those that they are matched to.
        similarity: (M,) of the descriptors; -1 where there is no match.
        rows: their rows, with depth in time by the guess.
    """

    to: Int[Array, " k"]
    slots: Int[Array, " m"]
    source: FrameFeatures
    target: FrameFeatures
    similarity: Float[Array, " m"]
    rows: MatchedRows


def _matched(
    source: FrameFeatures,
    target: FrameFeatures,
    guess: jaxlie.SE3,
    params: TrackerParams,
    sweep: gicp.Sweep | None,
    guess_known: Bool[Array, ""] | bool,
) -> _Matched:
    config = params.config.features
    matches = match(
        source.keypoints.features,
        target.keypoints.features,
        min_similarity=config.min_similarity,
        expected=_expected(target.keypoints, guess, params.camera, config, guess_known),
    )
    measured = matches.valid & target.keypoints.measured[matches.index_b]
    alike = jnp.where(measured, matches.similarity, -1)
    _, slots = lax.top_k(lax.stop_gradient(alike), min(_MOST, len(alike)))
    source = replace(source, keypoints=source.keypoints.at(slots))
    target = replace(target, keypoints=target.keypoints.at(matches.index_b[slots]))
    seen, valid = keypoints_in_time(source, params, sweep, guess), measured[slots]
    weights = _weights(seen, target.keypoints, alike[slots], valid, config)
    pixels = seen.features.keypoints
    points, noise = target.keypoints.points, params.noise.detected
    rows = MatchedRows(points, pixels, seen.depth, valid, noise, config.kernel_width, sweep, weights)
    return _Matched(matches.index_b, slots, source, target, alike[slots], rows)


def num_explained(
    T_target_source: jaxlie.SE3,
    matched: FeatureRegistration,
    source: Keypoints,
    target: Keypoints,
    params: TrackerParams,
    sweep: gicp.Sweep | None = None,
) -> Int[Array, ""]:
    """Inliers that another motion explains too, counted."""
    config, points = params.config.features, target.points[matched.index]
    sigma, width = params.noise.pixels, config.matched_kernel_width
    rows = MatchedRows(points, matched.pixels, source.depth, matched.inliers, sigma, width, sweep)
    return jnp.sum(_explained(T_target_source, rows, params, config.inlier_pixels), dtype=jnp.int32)


def _guess_or_rigid_motion(guess: jaxlie.SE3, matched: _Matched, params: TrackerParams) -> jaxlie.SE3:
    """The guess if it explains most of the matches, else it or a rigid motion, whichever explains more."""
    rows = matched.rows
    shares = _shares(rows, params.camera)
    guessed = _support(guess, rows, shares, params)

    def rigid() -> jaxlie.SE3:
        T = _rigid_motion(matched, params)
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
    source: Keypoints,
    target: Keypoints,
    similarity: Float[Array, " m"],
    valid: Bool[Array, " m"],
    config: FeaturesConfig,
) -> Float[Array, " m"] | None:
    """Weights of the matches, with a mean of 1, so that they say nothing about the noise of all of them."""
    if config.match_weights == "equal":
        return None
    # At the floor a match weighs nothing: one that comes or goes there moves no pose.
    certain = jnp.where(valid, similarity - config.min_similarity, 0)
    weights = certain * source.features.scores * target.features.scores
    mean = jnp.sum(weights) / jnp.maximum(jnp.sum(valid.astype(weights.dtype)), 1)
    return weights / jnp.where(mean > 0, mean, 1)


def _rigid_motion(matched: _Matched, params: TrackerParams) -> jaxlie.SE3:
    """The motion that lays most of the best matches' points on each other."""
    config, rows = params.config.features, matched.rows
    measured = rows.depth > 0
    points = params.camera.unproject(rows.pixels, jnp.where(measured, rows.depth, 1))
    best = jnp.where(measured, matched.similarity, -1)
    similarity, order = lax.top_k(best, min(config.max_rigid_matches, len(best)))
    return gicp.rigid_from_matches(
        points[order],
        rows.points[order],
        1 / jnp.maximum(rows.depth[order], 0.3) ** 2,
        valid=similarity > 0,
        max_distance=config.max_distance,
        refined=False,
    ).T_target_source


def _explained(T: jaxlie.SE3, rows: MatchedRows, params: TrackerParams, pixels: float) -> Bool[Array, " k"]:
    at = row_residuals(T, rows, params)
    error = jnp.sum(at.residual[:2] ** 2, axis=0)
    near = jnp.abs(at.residual[2]) < params.config.features.inlier_depth_sigmas
    return at.has_image & near & (error < (pixels / rows.sigma) ** 2)


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
