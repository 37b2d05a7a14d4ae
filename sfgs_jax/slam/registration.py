"""Registration of one observation to another: by keypoints, by GICP, and by both together."""

from enum import IntEnum
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax import gicp
from sfgs_jax.geometry import Camera, se3
from sfgs_jax.slam.config import TrackingConfig
from sfgs_jax.slam.matched_motion import MatchedMotion, motion_from_keypoints, num_explained
from sfgs_jax.slam.observation import Observation


class Carrier(IntEnum):
    """What a pose rests on."""

    NONE = 0
    """Nothing: the registration failed."""
    BOTH = 1
    """Keypoints and surface."""
    SURFACE = 2
    """GICP alone."""
    KEYPOINTS = 3
    """Matched keypoints alone."""
    COASTING = 4
    """GICP, with the guess where the surface leaves a direction free."""


class Registration(eqx.Module):
    """A motion with what supports it.

    Attributes:
        T_target_source: the motion.
        surface_information: (6, 6) of its tangent by GICP, 0 if that failed.
        matched: the motion by keypoints alone, and its matches.
        carrier: a `Carrier`.
        inlier_fraction: share of the source's points that lie on the target.
        rmse: root mean square distance of those along the normals, metres.
        free: directions of motion that the surface leaves free, 0 to 6.
    """

    T_target_source: jaxlie.SE3
    surface_information: Float[Array, "6 6"]
    matched: MatchedMotion
    carrier: Int[Array, ""]
    inlier_fraction: Float[Array, ""]
    rmse: Float[Array, ""]
    free: Int[Array, ""]

    @property
    def information(self) -> Float[Array, "6 6"]:
        """(6, 6) by surface and keypoints together, of those that carry the motion."""
        keypoints = (self.carrier == Carrier.BOTH) | (self.carrier == Carrier.KEYPOINTS)
        return self.surface_information + jnp.where(keypoints, self.matched.information, 0)


@partial(jax.jit, static_argnames="config")
def register(
    source: Observation, target: Observation, guess: jaxlie.SE3, camera: Camera, config: TrackingConfig
) -> Registration:
    """Find T_target_source.

    Matched keypoints give a robust motion; where there are too few, the guess takes its place. GICP starts
    there, and minimises the distances of the surfaces together with the reprojection error of the matches:
    that error enters as its quadratic form at its own minimum, which is what a Gauss-Newton step on both
    kinds of residuals sees of it. Each weighs by its noise, so where the surface leaves a direction free
    (a bare wall, a sphere) the keypoints decide, and where nothing matches the surface does. A few matches
    are a help to the surface; many stand without it, and against it. SFGS-SLAM (Wang and Deng, 2025),
    section 3.2.

    Args:
        source: the observation to locate.
        target: the observation to locate it in.
        guess: T_target_source as it is thought to be.
        camera: intrinsics of both.
        config: settings; static.
    """
    features = config.features
    matched = motion_from_keypoints(source.keypoints, target.keypoints, guess, camera, features)
    share = matched.num_inliers / jnp.maximum(matched.num_matches, 1)
    keypoints = (matched.num_inliers >= features.min_inliers) & (share >= features.min_inlier_share)
    many = matched.num_inliers >= features.min_inliers_alone
    T = _choose(keypoints, matched.T_target_source, guess)
    if not config.use_surface:
        carrier = jnp.where(keypoints & many, int(Carrier.KEYPOINTS), int(Carrier.NONE))
        zero = jnp.zeros(())
        return Registration(T, jnp.zeros((6, 6)), matched, carrier, zero, zero, jnp.asarray(0))

    # Without keypoints the guess itself is a weak prior, which decides where the surface does not.
    weak = jnp.eye(6) / config.guess_sigma**2
    prior = gicp.MotionPrior(T, jnp.where(keypoints, matched.information, weak))
    # Many keypoints bring the start within reach of the finer levels.
    coarsest = jnp.where(keypoints & many, 1, config.gicp.levels - 1)
    result = gicp.align(source.cloud, target.cloud, T, prior=prior, coarsest=coarsest, config=config.gicp)
    fits = result.inlier_fraction >= config.min_inlier_fraction
    free = jnp.sum(result.free)
    # Where the surface leaves a direction free nothing would contradict a few matches that are wrong alike.
    keypoints &= (free == 0) | (share >= features.min_inlier_share_alone) | ~fits
    found = _choose(keypoints, result.T_target_source, _held(result, guess))
    surface = fits & jnp.all(jnp.isfinite(found.wxyz_xyz))
    # Many matches that agree on another motion, and don't bear this one out, prove the surface's wrong.
    borne_out = num_explained(found, matched, source.keypoints, target.keypoints, camera, features)
    close = _apart(matched.T_target_source, found) < config.max_disagreement
    agree = keypoints & (close | (2 * borne_out > matched.num_inliers))
    contradicted = keypoints & many & ~agree
    near = _apart(guess, found) < config.max_correction_alone
    # What lies outside the target's image says nothing, what it shows and doesn't bear out does.
    least = jnp.maximum(config.min_inlier_fraction_alone, config.min_agreement_alone * result.overlap)
    alone = near & (result.inlier_fraction >= least)
    surface &= agree | (alone & ~contradicted)
    unaided = jnp.where(free > 0, int(Carrier.COASTING), int(Carrier.SURFACE))
    carrier = jnp.where(
        surface,
        jnp.where(agree, int(Carrier.BOTH), unaided),
        jnp.where(keypoints & many, int(Carrier.KEYPOINTS), int(Carrier.NONE)),
    )
    return Registration(
        _choose(surface, found, T),
        jnp.where(surface, result.information, 0),
        matched,
        carrier,
        result.inlier_fraction,
        result.rmse,
        free,
    )


def extent(T: jaxlie.SE3) -> float:
    """How far a motion goes: metres or radians, the larger."""
    moved = np.asarray(se3.log(T))
    return float(max(np.linalg.norm(moved[:3]), np.linalg.norm(moved[3:])))


def _held(result: gicp.RegistrationResult, guess: jaxlie.SE3) -> jaxlie.SE3:
    """The motion found, but for the directions that the surface leaves free: there the guess.

    What noise, outlines and the facets of a smooth surface pull at there would add up from frame to frame.
    """
    off = se3.log(se3.compose(se3.inverse(guess), result.T_target_source))
    shares = jnp.linalg.solve(result.directions, off)
    return se3.compose(guess, se3.exp(result.directions @ jnp.where(result.free, 0, shares)))


def _apart(a: jaxlie.SE3, b: jaxlie.SE3) -> Float[Array, ""]:
    """By how much two motions differ: metres or radians, the larger."""
    off = se3.log(se3.compose(se3.inverse(a), b))
    return jnp.maximum(jnp.linalg.norm(off[:3]), jnp.linalg.norm(off[3:]))


def _choose(condition: Bool[Array, ""], a: jaxlie.SE3, b: jaxlie.SE3) -> jaxlie.SE3:
    return jaxlie.SE3(jnp.where(condition, a.wxyz_xyz, b.wxyz_xyz))
