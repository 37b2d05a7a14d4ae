"""Times at which the rows of an RGB-D camera's two images were exposed, and what the motion does to them."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from sfgs_jax.arrays import checked, require_least


def _as_float(value: ArrayLike) -> Array:
    array = jnp.asarray(value)
    return jnp.asarray(array, array.dtype if jnp.issubdtype(array.dtype, jnp.floating) else jnp.float32)


class SensorTiming(eqx.Module):
    """When the rows of colour and depth are exposed, relative to the middle row of colour; seconds.

    A rolling shutter exposes one row after the other, and the two streams of an RGB-D camera need not start
    together. All zeros stand for a global shutter that takes both at once. Gradients reach every field.

    Source: Ringaby and Forssén, Scan Rectification for Structured Light Range Sensors with Rolling Shutters
    (ICCV 2011).

    Attributes:
        depth_delay: from colour's middle row to depth's; negative if depth is exposed first.
        colour_readout: from colour's first row to its last.
        depth_readout: from depth's first row to its last.
    """

    depth_delay: Float[Array, ""] = eqx.field(converter=_as_float, default=0.0)
    colour_readout: Float[Array, ""] = eqx.field(converter=_as_float, default=0.0)
    depth_readout: Float[Array, ""] = eqx.field(converter=_as_float, default=0.0)

    @property
    def vector(self) -> Float[Array, "3"]:
        """The three times, in the order of the attributes."""
        return jnp.stack([self.depth_delay, self.colour_readout, self.depth_readout])

    def on_host(self) -> Float[np.ndarray, "3"]:
        """As `vector`, fetched without running a program."""
        times = self.depth_delay, self.colour_readout, self.depth_readout
        return np.asarray([np.asarray(time) for time in times])

    @staticmethod
    def of_vector(times: Float[Array, "3"]) -> "SensorTiming":
        """Timing of three times, in the order of the attributes."""
        return SensorTiming(times[0], times[1], times[2])

    def colour_times(self, places: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Times of rows of the colour image.

        Args:
            places: of the rows in the image, from `row_places`.
        """
        return self.colour_readout * places

    def depth_times(self, places: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Times of rows of the depth image; arguments as of `colour_times`."""
        return self.depth_delay + self.depth_readout * places


class RollingShutter(eqx.Module):
    """Motion of a camera while it exposes an image row after row. Gradients reach all fields.

    Attributes:
        twist: (6,) motion per second in the camera's own frame, translation first; 0 for a camera at rest.
        readout: from the first row to the last, seconds; 0 for a global shutter.
        exposure: for which a row gathers light, seconds, half of it before its time: the motion blurs the
            image. None for an image without blur.
    """

    twist: Float[Array, "6"]
    readout: Float[Array, ""] = eqx.field(converter=_as_float)
    exposure: Float[Array, ""] | None = eqx.field(
        converter=lambda value: None if value is None else _as_float(value), default=None
    )


@checked
def row_places(rows: Float[Array, "*n"], height: int) -> Float[Array, "*n"]:
    """Places of rows in an image, from -1/2 at the top to 1/2 at the bottom, the same at every resolution.

    Args:
        rows: row coordinates; the first row lies at 0.
        height: rows of the image.

    Raises:
        InputError: there is no row.
    """
    require_least(height, 1, "height of row_places")
    return (rows + 0.5) / height - 0.5


@checked
def velocities(points: Float[Array, "3 N"], twist: Float[Array, "6"]) -> Float[Array, "3 N"]:
    """Velocity of points that move with a camera, metres per second: v + w x p.

    Args:
        points: camera coordinates, metres.
        twist: motion of the camera per second in its own frame, translation first.
    """
    return jnp.stack(_added(tuple(twist[:3]), _cross(tuple(twist[3:]), tuple(points))))


@checked
def carried(
    points: Float[Array, "3 N"], twist: Float[Array, "6"], times: Float[Array, " N"]
) -> Float[Array, "3 N"]:
    """Points seen at other times, in the camera of time 0: exp(times twist) points, to second order.

    Rows lie some 15 ms from the middle. Even at 3 rad/s the third order is 15 micrometres a metre.

    Args:
        points: camera coordinates at the points' own times, metres.
        twist: motion of the camera per second in its own frame, translation first.
        times: seconds.
    """
    at, turning = tuple(points), tuple(twist[3:])
    return jnp.stack(_moved(at, _added(tuple(twist[:3]), _cross(turning, at)), turning, times))


@checked
def turned(
    directions: Float[Array, "3 N"], twist: Float[Array, "6"], times: Float[Array, " N"]
) -> Float[Array, "3 N"]:
    """Directions seen at other times, in the camera of time 0; arguments as of `carried`."""
    at, turning = tuple(directions), tuple(twist[3:])
    return jnp.stack(_moved(at, _cross(turning, at), turning, times))


_Rows = tuple[Array, ...]
"""The three rows of vectors (3, N), or three numbers. XLA fuses sums of products of these with what comes
before and after; `jnp.cross` it does not. Taken apart once, they make half the program."""


def _moved(points: _Rows, speed: _Rows, turning: _Rows, times: Float[Array, " N"]) -> list[Array]:
    """Points after some times with a speed that turns along."""
    half = times / 2
    rows = zip(points, speed, _cross(turning, speed), strict=True)
    return [point + times * (v + half * a) for point, v, a in rows]


def _cross(w: _Rows, p: _Rows) -> _Rows:
    """w x p."""
    return w[1] * p[2] - w[2] * p[1], w[2] * p[0] - w[0] * p[2], w[0] * p[1] - w[1] * p[0]


def _added(a: _Rows, b: _Rows) -> _Rows:
    """a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]
