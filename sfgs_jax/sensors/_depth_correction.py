"""Calibration of a depth camera: a smooth error of inverse depth, and its pose beside the colour camera."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.lax import Precision
from jaxtyping import Array, Float, Int

from sfgs_jax.arrays import checked
from sfgs_jax.geometry import Camera, clean_depth
from sfgs_jax.sensors._depth_registration import registered_depth

DEPTH_GRID = (6, 16)
"""Rows and columns of the grid. A Kinect's distortion has vertical bands, about a tenth of the image wide."""


class DepthCorrection(eqx.Module):
    """Correction of depth: 1 / z = 1 / measured - offset, with an offset of each pixel for all frames.

    Structured light and stereo measure a disparity, so an error of their calibration is one of inverse depth.
    The offsets are those of a grid, interpolated linearly between its nodes. Then depth is seen from the
    colour camera: `extrinsic` is what the camera's own registration leaves out. All zeros change nothing.
    Gradients reach both fields.

    Source: Schöps, Sattler and Pollefeys, BAD SLAM (CVPR 2019), section 3.3, with a grid like theirs.

    Attributes:
        offsets: (R, C) of the nodes, 1/m; those at the ends lie on the image's borders.
        extrinsic: (6,) tangent of T_colour_depth, metres and radians; None where there is none.
    """

    offsets: Float[Array, "R C"]
    extrinsic: Float[Array, "6"] | None = None

    @property
    def vector(self) -> Float[Array, " G"]:
        """All parameters: the offsets row by row, then the extrinsic, zeros where there is none."""
        offsets, extrinsic = self.offsets.reshape(-1), self.extrinsic
        return jnp.concatenate([offsets, jnp.zeros(6, offsets.dtype) if extrinsic is None else extrinsic])

    def on_host(self) -> Float[np.ndarray, " G"]:
        """The same numbers as `vector`, fetched without running a program."""
        extrinsic = np.zeros(6) if self.extrinsic is None else np.asarray(self.extrinsic)
        return np.concatenate([np.asarray(self.offsets).reshape(-1), extrinsic])

    def with_vector(self, parameters: Float[Array, " G"]) -> "DepthCorrection":
        """A correction like this one with other parameters.

        Args:
            parameters: in the order of `vector`; the extrinsic's count for nothing where there is none.
        """
        extrinsic = None if self.extrinsic is None else parameters[-6:]
        return DepthCorrection(parameters[:-6].reshape(self.offsets.shape), extrinsic)

    def image(self, camera: Camera) -> Float[Array, "H W"]:
        """Offsets of all pixels, 1/m.

        Args:
            camera: whose images are corrected, at any resolution.
        """
        down, across = (
            _shares(_places(jnp.arange(size, dtype=self.offsets.dtype), size, nodes), nodes)
            for size, nodes in zip((camera.height, camera.width), self.offsets.shape, strict=True)
        )
        by_row = jnp.matmul(down.T, self.offsets, precision=Precision.HIGHEST)
        return jnp.matmul(by_row, across, precision=Precision.HIGHEST)

    def at(self, pixels: Float[Array, "N 2"], camera: Camera) -> Float[Array, " N"]:
        """Offsets at some pixels, 1/m.

        Args:
            pixels: (u, v); those beyond the borders count as on them.
            camera: of the image.
        """
        return grid_values(self.offsets[None], jnp.zeros(len(pixels), jnp.int32), pixels, camera)

    def corrected(self, depth: Float[Array, "H W"], camera: Camera) -> Float[Array, "H W"]:
        """Depth without the distortion in colour's camera, metres; behind infinity it is missing, 0.

        Args:
            depth: metres along z; not finite or not positive counts as missing.
            camera: of the image.
        """
        depth, valid = clean_depth(depth)
        undistorted = corrected_depth(depth, jnp.where(valid, self.image(camera), 0))
        if self.extrinsic is None:
            return undistorted
        return registered_depth(undistorted, camera, self.extrinsic)


@checked
def corrected_depth(depth: Float[Array, "*n"], offsets: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Depth after its inverse lost an offset, metres; 0 where that leaves no surface.

    Args:
        depth: metres, 0 where missing.
        offsets: of inverse depth, 1/m.
    """
    ratio = 1 - offsets * depth
    return jnp.where(ratio > 0, depth / jnp.where(ratio > 0, ratio, 1), 0)


@checked
def grid_values(
    grids: Float[Array, "n R C"], numbers: Int[Array, " N"], pixels: Float[Array, "N 2"], camera: Camera
) -> Float[Array, " N"]:
    """Values of grids at some pixels, interpolated linearly between their nodes.

    Args:
        grids: values of the nodes.
        numbers: of the grid that each pixel asks.
        pixels: (u, v); those beyond the borders count as on them.
        camera: of the image.
    """
    _, rows, columns = grids.shape
    across, down = _places(pixels[:, 0], camera.width, columns), _places(pixels[:, 1], camera.height, rows)
    left, above = (
        jnp.clip(lax.stop_gradient(jnp.floor(places)), 0, max(nodes - 2, 0))
        for places, nodes in ((across, columns), (down, rows))
    )
    first = (numbers * rows + above.astype(jnp.int32)) * columns + left.astype(jnp.int32)
    nodes = grids.reshape(-1)
    right, below = across - left, down - above
    upper, lower = (
        nodes[first + step] * (1 - right) + nodes[first + step + 1] * right for step in (0, columns)
    )
    return upper * (1 - below) + lower * below


@checked
def grid_shares(
    pixels: Float[Array, "N 2"], camera: Camera, shape: tuple[int, int] = DEPTH_GRID
) -> Float[Array, "G N"]:
    """Share of each node of a grid in the offsets at some pixels; G = R C, row by row.

    Args:
        pixels: (u, v); those beyond the borders count as on them.
        camera: of the image.
        shape: rows and columns of the grid.
    """
    rows, columns = shape
    places = _places(pixels[:, 0], camera.width, columns), _places(pixels[:, 1], camera.height, rows)
    # In a loop, since XLA on CPU would otherwise compute these shares anew for each node of the grid.
    across, down = lax.map(lambda at: _shares(at, max(shape)), jnp.stack(places))
    return (down[:rows, None] * across[None, :columns]).reshape(rows * columns, -1)


def _places(positions: Float[Array, " n"], size: int, nodes: int) -> Float[Array, " n"]:
    """Positions along one axis, pixels, in steps of the grid from its first node."""
    return jnp.clip((positions + 0.5) / size, 0, 1) * (nodes - 1)


def _shares(places: Float[Array, " n"], nodes: int) -> Float[Array, "k n"]:
    """Linear interpolation along one axis: the share of each node at some places."""
    return jnp.maximum(1 - jnp.abs(places[None] - jnp.arange(nodes, dtype=places.dtype)[:, None]), 0)
