"""Pinhole camera without lens distortion."""

from numbers import Integral

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from sfgs_jax.arrays import InputError, checked, described, is_array, is_known, printed


def _as_float(value: ArrayLike) -> Array:
    """A floating array of strong type; one of weak type would compile a second program."""
    try:
        array = jnp.asarray(value)
    except (TypeError, ValueError):
        array = None
    if array is None or array.shape != ():
        raise InputError(f"An intrinsic of a Camera is a number in pixels, not {described(value)}.")
    dtype = array.dtype if jnp.issubdtype(array.dtype, jnp.floating) else jnp.float32
    return jnp.asarray(array, dtype)


def _as_size(value: int) -> int:
    """A whole number of pixels; NumPy's integers become Python's."""
    if isinstance(value, bool) or not isinstance(value, Integral) or value < 1:
        raise InputError(
            f"The width and height of a Camera are whole numbers of pixels of at least 1, not {value!r}."
        )
    return int(value)


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

    Raises:
        InputError: a size is no whole number, a focal length is not positive and finite, or the principal
            point is not finite. Traced intrinsics are not looked at.
    """

    fx: Float[Array, ""] = eqx.field(converter=_as_float)
    fy: Float[Array, ""] = eqx.field(converter=_as_float)
    cx: Float[Array, ""] = eqx.field(converter=_as_float)
    cy: Float[Array, ""] = eqx.field(converter=_as_float)
    width: int = eqx.field(static=True, kw_only=True, converter=_as_size)
    height: int = eqx.field(static=True, kw_only=True, converter=_as_size)

    def __check_init__(self) -> None:
        for name in ("fx", "fy"):
            value = getattr(self, name)
            if is_known(value) and not 0 < np.asarray(value) < np.inf:
                raise InputError(f"{name} of a Camera is a finite number of pixels above 0, not {value}.")
        for name in ("cx", "cy"):
            value = getattr(self, name)
            if is_known(value) and not np.isfinite(np.asarray(value)):
                raise InputError(f"{name} of a Camera is a finite number of pixels, not {value}.")

    def __repr__(self) -> str:
        numbers = (f"{name}={_shortest(getattr(self, name))}" for name in ("fx", "fy", "cx", "cy"))
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


@checked
def same_camera(a: Camera, b: Camera) -> bool:
    """Whether two cameras have images of one size and the same intrinsics, to a millionth.

    Args:
        a: camera.
        b: camera.
    """
    return a.shape == b.shape and bool(np.allclose(a.matrix(), b.matrix(), rtol=1e-6))


def require_camera(camera: Camera) -> None:
    """Refuse anything but a camera.

    Raises:
        InputError: it is something else.
    """
    if not isinstance(camera, Camera):
        raise InputError(
            f"The camera is a Camera, not {described(camera)}: Camera(fx, fy, cx, cy, width=..., height=...)."
        )


def _shortest(value: object) -> str:
    """All digits of a number that it takes to tell it from others; shape and type of anything else."""
    whole = is_array(value) and is_known(value) and value.ndim == 0
    return str(np.asarray(value)[()]) if whole else printed(value)
