"""Features of a frame: its surface for GICP, and its keypoints with their depth."""

from dataclasses import replace

import equinox as eqx
import jax
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax import gicp
from sfgs_jax.superfeats import Features


class Keypoints(eqx.Module):
    """Keypoints of a frame with the depth measured there.

    Attributes:
        features: positions and descriptors, K slots.
        depth: (K,) metres along z; 0 where it is missing or the keypoint lies on a depth edge.
        points: (K, 3) camera coordinates, metres; on the image plane at 1 m where there is no depth.
        normals: (K, 3) of the surface there, unit vectors that face the camera; 0 where unknown.
        signature: (D,) descriptor of the whole image, of unit length; 0 without keypoints.
        places: (K, 2) pixels (u, v) in the image as it was read, which a rectification leaves as they are.
    """

    features: Features
    depth: Float[Array, " k"]
    points: Float[Array, "k 3"]
    normals: Float[Array, "k 3"]
    signature: Float[Array, " d"]
    places: Float[Array, "k 2"]

    @property
    def measured(self) -> Bool[Array, " k"]:
        """(K,) slots that hold a keypoint with depth."""
        return self.features.valid & (self.depth > 0)

    def at(self, slots: Int[Array, " m"]) -> "Keypoints":
        """The keypoints in some of the slots.

        Args:
            slots: their numbers.
        """
        lanes = self.features, self.depth, self.points, self.normals, self.places
        features, depth, points, normals, places = jax.tree.map(lambda x: x[slots], lanes)
        return replace(self, features=features, depth=depth, points=points, normals=normals, places=places)


class FrameFeatures(eqx.Module):
    """Everything that registration uses of a frame.

    Attributes:
        cloud: depth pyramid with normals.
        keypoints: keypoints; no slots at all where they are switched off.
        grey: (h, w) image as it was read, reduced for its patches; empty where none are compared.
    """

    cloud: gicp.OrganisedCloud
    keypoints: Keypoints
    grey: Float[Array, "h w"]

    @property
    def registrable(self) -> Bool[Array, ""]:
        """True if another frame could be registered to this one."""
        return self.cloud.levels[0].valid.any() | self.keypoints.measured.any()
