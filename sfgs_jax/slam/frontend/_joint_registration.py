"""Registration of one frame to another: by keypoints, by GICP, and by both together."""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
from jax import lax
from jax.lax import Precision
from jaxtyping import Array, Bool, Float

from sfgs_jax import gicp
from sfgs_jax.arrays import checked
from sfgs_jax.geometry import se3
from sfgs_jax.slam.config import TrackingConfig
from sfgs_jax.slam.frontend._depth_scale import depth_scale_change, is_other_scale, is_same_scale
from sfgs_jax.slam.frontend._feature_registration import (
    keypoints_in_time,
    motion_from_keypoints,
    num_explained,
    with_derivatives,
)
from sfgs_jax.slam.frontend._image_correlation import image_correlation
from sfgs_jax.slam.frontend._pose_source import (
    Evidence,
    images_look_alike,
    judge,
    keypoints_are_many,
    keypoints_are_sure,
    keypoints_help,
    keypoints_take_part,
    rests_on_surface,
    surface_agrees,
    surface_fits,
)
from sfgs_jax.slam.state._frame_features import FrameFeatures
from sfgs_jax.slam.state._registration import FeatureRegistration, PoseSource, Registration
from sfgs_jax.slam.state._tracker import TrackerParams

_DENYING = 5
"""Matches that fit no motion, in least numbers to stand alone, which speak against the motion model: 100."""


class Allowed(NamedTuple):
    """Sources of a pose that the frames before allow.

    Attributes:
        surface: whether the surface alone may give the pose.
        motion_model: whether the motion model may fill the directions that the surface leaves free.
        near_guess: whether the camera is near the guess: it was seen in the frame before, and none is missing
            between. Otherwise it may be anywhere, and a few matches agree in many places. Then keypoints
            count only if many agree, most of those that look alike, and the surface with them. The surface
            alone gives no pose where many keypoints match and fit no motion, and has to agree twice as well.
        doubtful_scale: whether the sensor seems to have changed its scale of depth. Then nothing is believed
            but what shows the scale to be the same.
        images: whether the images may differ, as they do in fog. They may not where the frame before looked
            like its reference.
    """

    surface: Bool[Array, ""] | bool = True
    motion_model: Bool[Array, ""] | bool = True
    near_guess: Bool[Array, ""] | bool = True
    doubtful_scale: Bool[Array, ""] | bool = False
    images: Bool[Array, ""] | bool = True


@checked
def register(
    params: TrackerParams,
    source: FrameFeatures,
    target: FrameFeatures,
    guess: jaxlie.SE3,
    allowed: Allowed | None = None,
    sweep: gicp.Sweep | None = None,
    *,
    guess_known: Bool[Array, ""] | bool = True,
) -> Registration:
    """Find T_target_source by keypoints and surface together.

    Matched keypoints give a robust motion; where there are too few, the guess takes its place. GICP starts
    there and minimises its own residuals together with the matches' reprojection error. The latter enters as
    its quadratic form at its own minimum, which equals a Gauss-Newton step on both kinds of residuals. Each
    weighs by its noise. So the keypoints decide where the surface leaves a direction free (a bare wall, a
    sphere), and the surface decides where nothing matches. SFGS-SLAM (Wang and Deng, 2025), section 3.2.

    Args:
        params: parameters of tracking.
        source: the frame to locate.
        target: the frame to locate it in.
        guess: T_target_source to start from.
        allowed: sources of a pose that the frames before allow; all of them if not given.
        sweep: motion of the source while it was read; None for a rectified source. The target is rectified.
        guess_known: whether the guess says where keypoints should lie. Of a frame that is looked for in a
            keyframe by its looks it does not.
    """
    # A default that is left out, or nothing in place of what is allowed, would make another program.
    return _register(params, source, target, guess, allowed or Allowed(), sweep, guess_known)


@partial(jax.jit, inline=True)
def _register(
    params: TrackerParams,
    source: FrameFeatures,
    target: FrameFeatures,
    guess: jaxlie.SE3,
    allowed: Allowed,
    sweep: gicp.Sweep | None,
    guess_known: Bool[Array, ""] | bool,
) -> Registration:
    config, features = params.config, params.config.features
    matched = motion_from_keypoints(source, target, guess, params, sweep, guess_known=guess_known)
    helpful, many = keypoints_help(matched, features), keypoints_are_many(matched, features)
    many_matches = matched.num_matches >= features.min_inliers_alone
    # So many matches show what the camera sees, and that no motion found explains it.
    denied = matched.num_matches >= _DENYING * features.min_inliers_alone
    start = _choose(helpful, matched.T_target_source, guess)
    source = replace(source, keypoints=keypoints_in_time(source, params, sweep, start))
    if not config.use_surface:
        compared = _compared(params, source, target, start, matched, sweep, allowed, guess_known)
        return _without_surface(matched, start, helpful, many, compared)

    surface = _align(params, source, target, matched, start, sweep)
    # Holes in the target's depth speak neither for a motion nor against it.
    fraction = surface.inlier_fraction / jnp.maximum(1 - surface.unmeasured, 1e-3)
    agreement = jnp.where(surface.overlap > 0, surface.inlier_fraction / surface.overlap, 1.0)
    num_free = jnp.sum(surface.free)
    keypoints = keypoints_take_part(matched, fraction, agreement, num_free, allowed.near_guess, config)
    T = _choose(keypoints, surface.T_target_source, _held_at_guess(surface, guess))
    fits = surface_fits(fraction, config)
    anywhere = surface_agrees(agreement, config, near_guess=False) & ~many_matches
    evidence = Evidence(
        keypoints=keypoints,
        many_keypoints=many & (keypoints_are_sure(matched, features) | ~fits),
        surface=fits & jnp.all(jnp.isfinite(T.wxyz_xyz)),
        agree=_agree(params, source, target, matched, T, sweep),
        surface_alone=_stands_alone(surface, agreement, _apart(guess, T), config),
        free=num_free > 0,
        surface_allowed=jnp.asarray(allowed.surface) & (allowed.near_guess | anywhere),
        motion_model_allowed=jnp.asarray(allowed.motion_model) & ~denied,
    )
    by_surface = rests_on_surface(evidence)
    T = _choose(by_surface, T, start)
    compared = _compared(params, source, target, T, matched, sweep, allowed, guess_known)
    evidence = evidence._replace(same_scale=compared.same_scale, images=compared.images)
    return Registration(
        T_target_source=T,
        surface_information=jnp.where(by_surface, surface.information, 0),
        matched=matched,
        source=judge(evidence),
        inlier_fraction=fraction,
        agreement=agreement,
        rmse=surface.rmse,
        num_free=num_free,
        scale_change=compared.scale_change,
        scale_sigma=compared.scale_sigma,
        image_correlation=compared.image_correlation,
    )


def found_again(
    params: TrackerParams,
    source: FrameFeatures,
    target: FrameFeatures,
    guess: jaxlie.SE3,
    allowed: Allowed,
    sweep: gicp.Sweep | None,
    found: Registration,
    *,
    guess_known: Bool[Array, ""] | bool,
) -> Registration:
    """A registration with the derivatives of its motions and of the keypoints' information.

    Both motions are minima with what was decided held fixed, so their derivatives take no steps.

    Args:
        params: parameters of tracking.
        source: the frame that was located.
        target: the frame that it was located in.
        guess: as of `register`.
        allowed: as of `register`.
        sweep: as of `register`.
        found: the result of `register`, which pose was believed.
        guess_known: as of `register`.
    """
    config, found = params.config, lax.stop_gradient(found)
    matched = with_derivatives(source, target, guess, params, sweep, found.matched, guess_known=guess_known)
    T = start = _choose(keypoints_help(found.matched, config.features), matched.T_target_source, guess)
    if config.use_surface:
        surface = _align(params, source, target, matched, start, sweep, found.T_target_source)
        fit = found.inlier_fraction, found.agreement, found.num_free
        keypoints = keypoints_take_part(found.matched, *fit, allowed.near_guess, config)
        T = _choose(keypoints, surface.T_target_source, _held_at_guess(surface, guess))
        T = _choose(found.source == PoseSource.KEYPOINTS, start, T)
    return eqx.tree_at(lambda f: (f.T_target_source, f.matched), found, (T, matched))


def _agree(
    params: TrackerParams,
    source: FrameFeatures,
    target: FrameFeatures,
    matched: FeatureRegistration,
    T: jaxlie.SE3,
    sweep: gicp.Sweep | None,
) -> Bool[Array, ""]:
    """True if the keypoints' motion is close to the surface's, or that explains most of their inliers."""
    config, points = params.config, (source.keypoints, target.keypoints)
    explained = num_explained(T, matched, *points, params, sweep)
    close = _apart(matched.T_target_source, T) < config.max_disagreement
    return close | (2 * explained > matched.num_inliers)


def _scale(
    params: TrackerParams,
    source: FrameFeatures,
    target: FrameFeatures,
    T: jaxlie.SE3,
    matched: FeatureRegistration,
    sweep: gicp.Sweep | None,
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Change of the scale of depth and its standard deviation, without derivatives."""
    moving = None if sweep is None else sweep.at(T)
    return depth_scale_change(*lax.stop_gradient((params, source, target, T, matched, moving)))


class _Compared(NamedTuple):
    """Depth and images of two frames under a motion: the scale's change, the images' correlation, and whether
    each leaves the motion believable."""

    scale_change: Float[Array, ""]
    scale_sigma: Float[Array, ""]
    image_correlation: Float[Array, ""]
    same_scale: Bool[Array, ""]
    images: Bool[Array, ""]


def _compared(
    params: TrackerParams,
    source: FrameFeatures,
    target: FrameFeatures,
    T: jaxlie.SE3,
    matched: FeatureRegistration,
    sweep: gicp.Sweep | None,
    allowed: Allowed,
    guess_known: Bool[Array, ""] | bool,
) -> _Compared:
    config, features = params.config, params.config.features
    change, sigma = _scale(params, source, target, T, matched, sweep)
    correlation = image_correlation(source, target, T)
    near_guess = allowed.near_guess & jnp.asarray(guess_known)
    alike = images_look_alike(correlation, config, near_guess=near_guess)
    # Sure keypoints need no images, and where few match, an image may be noise.
    asked = ~keypoints_are_sure(matched, features) & (matched.num_matches >= features.min_inliers_alone)
    images = alike | ~asked | allowed.images
    return _Compared(change, sigma, correlation, _believed(change, sigma, allowed, config), images)


def _believed(
    change: Float[Array, ""], sigma: Float[Array, ""], allowed: Allowed, config: TrackingConfig
) -> Bool[Array, ""]:
    """True if the frames have the same scale of depth, as far as can be asked for."""
    limit = config.max_scale_change
    same = is_same_scale(change, sigma, limit)
    return jnp.where(jnp.asarray(allowed.doubtful_scale), same, ~is_other_scale(change, sigma, limit))


def _without_surface(
    matched: FeatureRegistration,
    T: jaxlie.SE3,
    helpful: Bool[Array, ""],
    many: Bool[Array, ""],
    compared: _Compared,
) -> Registration:
    """The registration by keypoints alone."""
    nothing = Evidence(
        helpful,
        many,
        surface=False,
        agree=False,
        surface_alone=False,
        free=False,
        same_scale=compared.same_scale,
        images=compared.images,
    )
    zero = jnp.zeros(())
    return Registration(
        T_target_source=T,
        surface_information=jnp.zeros((6, 6)),
        matched=matched,
        source=judge(nothing),
        inlier_fraction=zero,
        agreement=jnp.ones(()),
        rmse=zero,
        num_free=jnp.asarray(0),
        scale_change=compared.scale_change,
        scale_sigma=compared.scale_sigma,
        image_correlation=compared.image_correlation,
    )


def _align(
    params: TrackerParams,
    source: FrameFeatures,
    target: FrameFeatures,
    matched: FeatureRegistration,
    start: jaxlie.SE3,
    sweep: gicp.Sweep | None,
    minimum: jaxlie.SE3 | None = None,
) -> gicp.RegistrationResult:
    """GICP with the matches' quadratic form as a prior, or the motion model's where there are too few.

    If the minimum is given, the result is its derivative.
    """
    config, settings = params.config, params.config.gicp
    helpful, many = keypoints_help(matched, config.features), keypoints_are_many(matched, config.features)
    weak = jnp.eye(6) / config.motion_model_sigma**2
    prior = gicp.MotionPrior(start, jnp.where(helpful, matched.information, weak))
    # Many keypoints bring the start within reach of the finer levels.
    coarsest = jnp.where(helpful & many, 1, settings.levels - 1)
    clouds = source.cloud, target.cloud
    if minimum is not None:
        start, coarsest = minimum, jnp.zeros_like(coarsest)
        clouds = gicp.OrganisedCloud(clouds[0].levels[:1]), gicp.OrganisedCloud(clouds[1].levels[:1])
        settings = replace(settings, levels=1, max_iterations=(0,))
    return gicp.align(
        *clouds,
        start,
        prior=prior,
        coarsest=coarsest,
        sweep=sweep,
        noise=params.noise.surface,
        config=settings,
    )


def _stands_alone(
    surface: gicp.RegistrationResult,
    agreement: Float[Array, ""],
    correction: Float[Array, ""],
    config: TrackingConfig,
) -> Bool[Array, ""]:
    """True if GICP needs no keypoints: it ended near its start, on most of the surface in view.

    Points outside the target's image say nothing. Points inside that miss its surface speak against it.
    """
    fits = (surface.inlier_fraction >= config.min_inlier_fraction_alone) & surface_agrees(agreement, config)
    return (correction < config.max_correction_alone) & fits


def _held_at_guess(surface: gicp.RegistrationResult, guess: jaxlie.SE3) -> jaxlie.SE3:
    """The motion found, with the guess along the directions that the surface leaves free.

    Noise, outlines and the facets of a smooth surface pull along these, and would add up over the frames.
    """
    off = se3.log(se3.compose(se3.inverse(guess), surface.T_target_source))
    shares = jnp.where(surface.free, 0, jnp.linalg.solve(surface.directions, off))
    return se3.compose(guess, se3.exp(jnp.matmul(surface.directions, shares, precision=Precision.HIGHEST)))


def _apart(a: jaxlie.SE3, b: jaxlie.SE3) -> Float[Array, ""]:
    """Difference of two motions, metres or radians, the larger."""
    return extent(se3.compose(se3.inverse(a), b))


def extent(T: jaxlie.SE3) -> Float[Array, ""]:
    """Size of a motion, metres or radians, the larger."""
    return jnp.maximum(*se3.extent(T))


def _choose(condition: Bool[Array, ""], a: jaxlie.SE3, b: jaxlie.SE3) -> jaxlie.SE3:
    return jaxlie.SE3(jnp.where(condition, a.wxyz_xyz, b.wxyz_xyz))
