"""Judgement of a registration: which residuals its pose rests on, and which uses it is good enough for."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.slam.config import FeaturesConfig, GraphConfig, TrackingConfig
from sfgs_jax.slam.state._registration import BY_KEYPOINTS, FeatureRegistration, PoseSource, Registration

Flag = Bool[Array, ""] | bool


class Evidence(NamedTuple):
    """Evidence for and against a registration; every field is a flag.

    Attributes:
        keypoints: enough matches agree for the keypoints to take part.
        many_keypoints: enough of them agree to stand without the surface, or, if they are sure, against it.
        surface: GICP has enough inliers, and its motion is finite.
        agree: keypoints and GICP have found the same motion.
        surface_alone: GICP ended near its start, with enough inliers to need no keypoints.
        free: the surface leaves a direction of motion free.
        surface_allowed: the camera was seen recently enough for the surface alone to tell where it is.
        motion_model_allowed: a motion was measured, no frame was lost since, and the motion model has not
            carried the pose too long or too far.
        same_scale: nothing says that the two frames measure depth in different units.
        images: nothing says that the two images show different things.
    """

    keypoints: Flag
    many_keypoints: Flag
    surface: Flag
    agree: Flag
    surface_alone: Flag
    free: Flag
    surface_allowed: Flag = True
    motion_model_allowed: Flag = True
    same_scale: Flag = True
    images: Flag = True


def keypoints_help(matched: FeatureRegistration, config: FeaturesConfig) -> Bool[Array, ""]:
    """True if enough matches agree on a motion for GICP to start from it.

    Args:
        matched: the motion by keypoints.
        config: settings.
    """
    agree = (_share_of_all(matched) >= config.min_inlier_share) | keypoints_are_alike(matched, config)
    return (matched.num_inliers >= config.min_inliers) & agree


def keypoints_are_many(matched: FeatureRegistration, config: FeaturesConfig) -> Bool[Array, ""]:
    """True if enough matches agree on a motion to stand without the surface.

    Args:
        matched: the motion by keypoints.
        config: settings.
    """
    return matched.num_inliers >= config.min_inliers_alone


def keypoints_are_alike(matched: FeatureRegistration, config: FeaturesConfig) -> Bool[Array, ""]:
    """True if the motion explains most of the matches around which the images agree.

    Args:
        matched: the motion by keypoints.
        config: settings.
    """
    return _share(matched) >= config.min_inlier_share_sure


def keypoints_are_sure(matched: FeatureRegistration, config: FeaturesConfig) -> Bool[Array, ""]:
    """True if the motion explains most of all matches, so that hardly another one explains as many.

    Args:
        matched: the motion by keypoints.
        config: settings.
    """
    return _share_of_all(matched) >= config.min_inlier_share_sure


def surface_agrees(
    agreement: Float[Array, ""], config: TrackingConfig, *, near_guess: bool = True
) -> Bool[Array, ""]:
    """True if the surface lies where the reference shows one.

    Args:
        agreement: share of surface inliers among the points that the reference shows.
        config: settings.
        near_guess: whether the camera is near the guess. Elsewhere half as many points may disagree.
    """
    return agreement >= _asked(config.min_agreement, near_guess)


def images_look_alike(
    correlation: Float[Array, ""], config: TrackingConfig, *, near_guess: Flag
) -> Bool[Array, ""]:
    """True if two images show the same under a motion.

    Args:
        correlation: by `image_correlation`.
        config: settings.
        near_guess: whether the camera is near the guess. Elsewhere half as much may differ.
    """
    return correlation >= _asked(config.min_image_correlation, near_guess)


def _asked(least: float, near_guess: Flag) -> Float[Array, ""]:
    """The least agreement that is asked for: away from the guess half as much may be missing."""
    return 1 - (1 - least) * jnp.where(near_guess, 1.0, 0.5)


def surface_fits(fraction: Float[Array, ""], config: TrackingConfig) -> Bool[Array, ""]:
    """True if the surface has enough inliers.

    Args:
        fraction: share of the source's points that lie on the target's surface.
        config: settings.
    """
    return fraction >= config.min_inlier_fraction


def keypoints_take_part(
    matched: FeatureRegistration,
    fraction: Float[Array, ""],
    agreement: Float[Array, ""],
    num_free: Int[Array, ""],
    near_guess: Flag,
    config: TrackingConfig,
) -> Bool[Array, ""]:
    """True if the keypoints take part in the pose.

    Args:
        matched: the motion by keypoints.
        fraction: share of the source's points that lie on the target's surface.
        agreement: the same of those points that the target shows.
        num_free: directions of motion that the surface leaves free.
        near_guess: whether the camera is near the guess.
        config: settings.
    """
    features = config.features
    many, agrees = keypoints_are_many(matched, features), surface_agrees(agreement, config)
    # Points inside the target's image that miss its surface speak against the motion.
    near = keypoints_are_sure(matched, features) | agrees
    anywhere = many & keypoints_are_alike(matched, features) & agrees
    counted = keypoints_help(matched, features) & jnp.where(near_guess, near, anywhere)
    # Nothing contradicts a few wrong matches that agree along a direction that the surface leaves free.
    certain = many & (_share(matched) >= features.min_inlier_share_alone)
    return counted & ((num_free == 0) | certain | ~surface_fits(fraction, config))


def _share(matched: FeatureRegistration) -> Float[Array, ""]:
    return matched.num_inliers / jnp.maximum(matched.num_matches, 1)


def _share_of_all(matched: FeatureRegistration) -> Float[Array, ""]:
    return matched.num_inliers / jnp.maximum(matched.num_detected, 1)


def judge(evidence: Evidence) -> Int[Array, ""]:
    """Residuals that a pose rests on.

    A dash stands for either. Few keypoints help the surface; many stand without it, and sure ones against it.
    Without the same scale of depth, or with images that differ, the frame is `LOST` whatever else holds: the
    motion that fits best is then wrong.

    | keypoints | many | surface | agree | surface alone | free | allowed | pose source |
    | --- | --- | --- | --- | --- | --- | --- | --- |
    | yes | - | yes | yes | - | - | - | `JOINT` |
    | yes | yes | - | no | - | - | - | `KEYPOINTS` |
    | yes | no | yes | no | yes | no | surface | `SURFACE` |
    | yes | no | yes | no | yes | yes | motion model | `MOTION_MODEL` |
    | no | - | yes | - | yes | no | surface | `SURFACE` |
    | no | - | yes | - | yes | yes | motion model | `MOTION_MODEL` |
    | any other | | | | | | | `LOST` |

    Args:
        evidence: flags, traced or concrete.

    Returns:
        A `PoseSource` as an integer.
    """
    e = Evidence(*(jnp.asarray(flag) for flag in evidence))
    joint = e.keypoints & e.surface & e.agree
    keypoints = e.keypoints & e.many_keypoints & ~joint
    alone = e.surface & e.surface_alone & ~joint & ~keypoints
    sources = (
        (joint, PoseSource.JOINT),
        (keypoints, PoseSource.KEYPOINTS),
        (alone & ~e.free & e.surface_allowed, PoseSource.SURFACE),
        (alone & e.free & e.motion_model_allowed, PoseSource.MOTION_MODEL),
    )
    numbers = [jnp.asarray(int(source), jnp.int32) for _, source in sources]
    return jnp.select(
        [when & e.same_scale & e.images for when, _ in sources], numbers, jnp.zeros((), jnp.int32)
    )


def rests_on_surface(evidence: Evidence) -> Bool[Array, ""]:
    """True if GICP's motion is the one to take, allowed or not: rows 1 and 3 to 6 of the table of `judge`.

    Args:
        evidence: flags, traced or concrete.
    """
    e = Evidence(*(jnp.asarray(flag) for flag in evidence))
    joint = e.keypoints & e.agree
    contradicted = e.keypoints & e.many_keypoints & ~e.agree
    return jnp.asarray(e.surface & (joint | (e.surface_alone & ~contradicted)))


def supports_relocalisation(found: Registration, config: GraphConfig) -> bool:
    """True if a lost frame is believed in a keyframe that only looks like it.

    Surfaces alone fit in many places, so many matches have to agree.

    Args:
        found: registration of the frame to the keyframe.
        config: settings.
    """
    keypoints = int(found.source) in BY_KEYPOINTS
    return keypoints and int(found.matched.num_inliers) >= config.relocalisation_inliers


def supports_edge(
    found: Registration, correction: float, config: GraphConfig, *, with_keypoints: bool
) -> bool:
    """True if a registration of neighbouring keyframes becomes an edge of the graph.

    Args:
        found: the registration.
        correction: its disagreement with the graph, metres or radians, the larger.
        config: settings.
        with_keypoints: whether there are keypoints at all; where there are, they must take part.
    """
    sources = BY_KEYPOINTS if with_keypoints else (PoseSource.SURFACE,)
    return int(found.source) in sources and correction < config.max_correction


def confirms_loop(found: Registration, config: GraphConfig) -> bool:
    """True if keypoints and surface confirm that two keyframes show the same, or what looks the same.

    Args:
        found: their registration.
        config: settings.
    """
    return (
        int(found.source) == PoseSource.JOINT
        and int(found.matched.num_inliers) >= config.loop_inliers
        and float(found.inlier_fraction) >= config.loop_inlier_fraction
    )


def supports_loop(found: Registration, off: np.ndarray, drift: float, config: GraphConfig) -> bool:
    """True if a registration may close a loop: keypoints and surface confirm it, and drift explains it.

    Two rooms that look the same pass every test of looks and fit. They fail this one: the graph is not that
    uncertain of where they are.

    Args:
        found: the registration.
        off: (6,) tangent of its disagreement with the graph.
        drift: largest drift that is likely between the keyframes, metres.
        config: settings.
    """
    near = np.linalg.norm(off[:3]) < config.loop_slack + drift
    return bool(confirms_loop(found, config) and near and np.linalg.norm(off[3:]) < config.max_turn)
