"""Registration of one frame to another: its motion and the evidence for it."""

from enum import IntEnum

import equinox as eqx
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Bool, Float, Int


class PoseSource(IntEnum):
    """Residuals that a pose rests on."""

    LOST = 0
    """None: the registration failed."""
    JOINT = 1
    """Keypoints and surface."""
    SURFACE = 2
    """GICP alone."""
    KEYPOINTS = 3
    """Matched keypoints alone."""
    MOTION_MODEL = 4
    """GICP, with the motion model along directions that the surface leaves free."""

    def __str__(self) -> str:
        return self.name


BY_KEYPOINTS = (PoseSource.JOINT, PoseSource.KEYPOINTS)
"""Sources in which matched keypoints take part."""


class FeatureRegistration(eqx.Module):
    """A motion found from matched keypoints alone, and its matches.

    Attributes:
        T_target_source: the motion.
        information: (6, 6) of its tangent (translation first, right perturbation), from the noise of pixels
            and of inverse depth.
        index: (K,) the target's slot for each slot of the source.
        inliers: (K,) matches that the motion explains.
        num_detected: number of matches.
        num_matches: number of those around which the images agree.
        num_inliers: number of inliers among them.
        pixels: (K, 2) places of the source's keypoints, refined where the images around a match agree.
        T_as_detected: the motion by the keypoints as they were detected.
    """

    T_target_source: jaxlie.SE3
    information: Float[Array, "6 6"]
    index: Int[Array, " k"]
    inliers: Bool[Array, " k"]
    num_detected: Int[Array, ""]
    num_matches: Int[Array, ""]
    num_inliers: Int[Array, ""]
    pixels: Float[Array, "k 2"]
    T_as_detected: jaxlie.SE3


class Registration(eqx.Module):
    """A motion with the evidence for it.

    Attributes:
        T_target_source: the motion.
        surface_information: (6, 6) of its tangent by GICP; 0 where GICP failed.
        matched: the motion by keypoints alone, and its matches.
        source: a `PoseSource`.
        inlier_fraction: share of the source's points that lie on the target, but for those at its holes.
        agreement: the same of those points that the target shows; 1 if it shows none.
        rmse: root mean square distance of those along the normals, metres.
        num_free: directions of motion that the surface leaves free, 0 to 6.
        scale_change: logarithm of the target's scale of depth over the source's.
        scale_sigma: standard deviation of that.
        image_correlation: correlation of the two images under the motion, the median over blocks of the
            source; 1 where there is nothing to compare.
    """

    T_target_source: jaxlie.SE3
    surface_information: Float[Array, "6 6"]
    matched: FeatureRegistration
    source: Int[Array, ""]
    inlier_fraction: Float[Array, ""]
    agreement: Float[Array, ""]
    rmse: Float[Array, ""]
    num_free: Int[Array, ""]
    scale_change: Float[Array, ""]
    scale_sigma: Float[Array, ""]
    image_correlation: Float[Array, ""]

    @property
    def found(self) -> Bool[Array, ""]:
        """Whether the registration succeeded."""
        return self.source != PoseSource.LOST

    @property
    def by_keypoints(self) -> Bool[Array, ""]:
        """Whether keypoints share in the motion."""
        return (self.source == PoseSource.JOINT) | (self.source == PoseSource.KEYPOINTS)

    @property
    def information(self) -> Float[Array, "6 6"]:
        """(6, 6) of the residuals that the motion rests on, surface and keypoints together."""
        return self.surface_information + jnp.where(self.by_keypoints, self.matched.information, 0)
