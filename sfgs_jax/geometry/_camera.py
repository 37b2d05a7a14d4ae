"""Pinhole camera without lens distortion."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import core
from jaxtyping import Array, ArrayLike, Float


def _as_float(value: ArrayLike) -> Array:
    """A floating array of strong type; one of weak type would compile a second program."""
    array = jnp.asarray(value)
    dtype = array.dtype if jnp.issubdtype(array.dtype, jnp.floating) else jnp.float32
    return jnp.asarray(array, dtype)


class Camera(eqx.Module):
    """Pinhole intrinsics in pixels; axes as in OpenCV (x right, y down, z forward).

    Pixel centres lie at integer coordinates: the ray through pixel (row v, column u) is
    ((u - cx) / fx, (v - cy) / fy, 1).

    Attributes:
        fx: focal length along u, pixels, scalar.
        fy: focal length along v, pixels, scalar.
        cx: principal point, column, scalar.
        cy: principal point, row, scalar.
        width: image width in pixels; static, so a new size compiles anew.
        height: image height in pixels; static.
    """

    fx: Float[Array, ""] = eqx.field(converter=_as_float)
    fy: Float[Array, ""] = eqx.field(converter=_as_float)
    cx: Float[Array, ""] = eqx.field(converter=_as_float)
    cy: Float[Array, ""] = eqx.field(converter=_as_float)
    width: int = eqx.field(static=True, kw_only=True)
    height: int = eqx.field(static=True, kw_only=True)

    def __repr__(self) -> str:
        numbers = (f"{name}={_printed(getattr(self, name))}" for name in ("fx", "fy", "cx", "cy"))
        return f"Camera({', '.join(numbers)}, width={self.width}, height={self.height})"

    @property
    def shape(self) -> tuple[int, int]:
        """Image shape (height, width)."""
        return self.height, self.width

    def matrix(self) -> Float[Array, "3 3"]:
        """Calibration matrix K."""
        zero, one = jnp.zeros_like(self.fx), jnp.ones_like(self.fx)
        return jnp.stack(
            [
                jnp.stack([self.fx, zero, self.cx]),
                jnp.stack([zero, self.fy, self.cy]),
                jnp.stack([zero, zero, one]),
            ]
        )

    def downscaled(self, factor: int) -> "Camera":
        """Camera of the image whose pixels are the means of factor x factor blocks of this one's.

        Rows and columns that don't fill a block are dropped.
        """
        centre = (factor - 1) / 2
        return Camera(
            self.fx / factor,
            self.fy / factor,
            (self.cx - centre) / factor,
            (self.cy - centre) / factor,
            width=self.width // factor,
            height=self.height // factor,
        )

    def pixels(self) -> Float[Array, "H W 2"]:
        """Coordinates (u, v) of every pixel."""
        u, v = jnp.meshgrid(
            jnp.arange(self.width, dtype=self.fx.dtype), jnp.arange(self.height, dtype=self.fx.dtype)
        )
        return jnp.stack([u, v], axis=-1)

    def unproject(self, pixels: Float[Array, "*n 2"], depth: Float[Array, "*n"]) -> Float[Array, "*n 3"]:
        """Points in camera coordinates, metres, of pixels (u, v) at `depth` metres along z."""
        x = (pixels[..., 0] - self.cx) / self.fx * depth
        y = (pixels[..., 1] - self.cy) / self.fy * depth
        return jnp.stack([x, y, depth], axis=-1)

    def project(self, points: Float[Array, "*n 3"]) -> Float[Array, "*n 2"]:
        """Pixels (u, v) of points in camera coordinates.

        Points at or behind the camera plane have no image. Theirs is the projection of the same point at a
        small positive depth, finite with finite gradients, for callers to mask.
        """
        z = jnp.maximum(points[..., 2], 1e-6)
        return jnp.stack(
            [self.fx * points[..., 0] / z + self.cx, self.fy * points[..., 1] / z + self.cy], axis=-1
        )


def _printed(value: Any) -> str:
    """Shortest digits of a scalar; shape and type of anything else, as of a traced or batched intrinsic."""
    if isinstance(value, jax.Array) and not isinstance(value, core.Tracer) and value.shape == ():
        return str(np.asarray(value)[()])
    return eqx.tree_pformat(value)
