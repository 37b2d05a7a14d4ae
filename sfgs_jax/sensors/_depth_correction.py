"""Distortion of a depth camera: an error of inverse depth that varies smoothly over the image."""

import equinox as eqx
import jax.numpy as jnp
from jax.lax import Precision
from jaxtyping import Array, Float

from sfgs_jax.geometry import Camera, clean_depth

DEPTH_GRID = (6, 16)
"""Rows and columns of the grid. A Kinect's distortion has vertical bands, about a tenth of the image wide."""


class DepthCorrection(eqx.Module):
    """Correction of depth: 1 / z = 1 / measured - offset, with an offset of each pixel for all frames.

    Structured light and stereo measure a disparity, so an error of their calibration is one of inverse depth.
    The offsets are those of a grid, interpolated linearly between its nodes. All zeros change nothing.
    Gradients reach the grid.

    Source: Schöps, Sattler and Pollefeys, BAD SLAM (CVPR 2019), section 3.3, with a grid like theirs.

    Attributes:
        offsets: (R, C) of the nodes, 1/m; those at the ends lie on the image's borders.
    """

    offsets: Float[Array, "R C"]

    def image(self, camera: Camera) -> Float[Array, "H W"]:
        """Offsets of all pixels, 1/m.

        Args:
            camera: whose images are corrected, at any resolution.
        """
        rows, columns = self.offsets.shape
        down = _shares(jnp.arange(camera.height, dtype=self.offsets.dtype), camera.height, rows)
        across = _shares(jnp.arange(camera.width, dtype=self.offsets.dtype), camera.width, columns)
        by_row = jnp.matmul(down.T, self.offsets, precision=Precision.HIGHEST)
        return jnp.matmul(by_row, across, precision=Precision.HIGHEST)

    def at(self, pixels: Float[Array, "N 2"], camera: Camera) -> Float[Array, " N"]:
        """Offsets at some pixels, 1/m.

        Args:
            pixels: (u, v); those beyond the borders count as on them.
            camera: of the image.
        """
        rows, columns = self.offsets.shape
        shares = grid_shares(pixels, camera, (rows, columns))
        return jnp.matmul(self.offsets.reshape(-1), shares, precision=Precision.HIGHEST)

    def corrected(self, depth: Float[Array, "H W"], camera: Camera) -> Float[Array, "H W"]:
        """Depth without the distortion, metres; what would lie behind infinity is missing, 0.

        Args:
            depth: metres along z; not finite or not positive counts as missing.
            camera: of the image.
        """
        depth, valid = clean_depth(depth)
        return corrected_depth(depth, jnp.where(valid, self.image(camera), 0))


def corrected_depth(depth: Float[Array, "*n"], offsets: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Depth after its inverse lost an offset, metres; 0 where that leaves no surface.

    Args:
        depth: metres, 0 where missing.
        offsets: of inverse depth, 1/m.
    """
    ratio = 1 - offsets * depth
    return jnp.where(ratio > 0, depth / jnp.where(ratio > 0, ratio, 1), 0)


def grid_shares(
    pixels: Float[Array, "N 2"], camera: Camera, shape: tuple[int, int] = DEPTH_GRID
) -> Float[Array, "G N"]:
    """Share of each node of a grid in the offsets at some pixels; G = R C, row by row.

    Args:
        pixels: (u, v); those beyond the borders count as on them.
        camera: of the image.
        shape: rows and columns of the grid.
    """
    down = _shares(pixels[:, 1], camera.height, shape[0])
    across = _shares(pixels[:, 0], camera.width, shape[1])
    return (down[:, None] * across[None]).reshape(shape[0] * shape[1], -1)


def _shares(positions: Float[Array, " n"], size: int, nodes: int) -> Float[Array, "k n"]:
    """Linear interpolation along one axis: the share of each node at some positions, pixels."""
    places = jnp.clip((positions + 0.5) / size, 0, 1) * (nodes - 1)
    return jnp.maximum(1 - jnp.abs(places[None] - jnp.arange(nodes, dtype=places.dtype)[:, None]), 0)
