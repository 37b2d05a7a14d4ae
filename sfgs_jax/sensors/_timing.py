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
    turning = _cross(twist[3:], points)
    return jnp.stack([speed + part for speed, part in zip(twist[:3], turning, strict=True)])


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
    first = velocities(points, twist)
    second = _cross(twist[3:], first)
    moved = zip(points, first, second, strict=True)
    return jnp.stack([point + times * (v + times / 2 * a) for point, v, a in moved])


@checked
def turned(
    directions: Float[Array, "3 N"], twist: Float[Array, "6"], times: Float[Array, " N"]
) -> Float[Array, "3 N"]:
    """Directions seen at other times, in the camera of time 0; arguments as of `carried`."""
    return carried(directions, twist.at[:3].set(0), times)


def _cross(w: Float[Array, "3"], points: Float[Array, "3 N"]) -> list[Float[Array, " N"]]:
    """Rows of w x p, which XLA fuses with what comes before and after; those of `jnp.cross` it does not."""
    x, y, z = points
    return [w[1] * z - w[2] * y, w[2] * x - w[0] * z, w[0] * y - w[1] * x]
