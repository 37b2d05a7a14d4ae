"""Motion of a camera while it reads the rows of a depth image."""

import equinox as eqx
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Bool, Float

from sfgs_jax.geometry import se3
from sfgs_jax.sensors import SensorTiming


class RowMotion(eqx.Module):
    """Motion of a camera while it read a frame, constant over the frame.

    Attributes:
        twist: (6,) motion per second in the camera's own frame, translation first; 0 where it is not known.
        timing: times of the rows, relative to the frame's.
        known: whether the motion is known.
    """

    twist: Float[Array, "6"]
    timing: SensorTiming
    known: Bool[Array, ""]


class Sweep(eqx.Module):
    """The same for a frame whose pose is sought: the motion from the frame before it, divided by the time.

    Attributes:
        T_target_before: pose of the frame before.
        seconds: time since then; 0 where it is unknown, and then the camera counts as still.
        timing: times of the rows, relative to the frame's.
    """

    T_target_before: jaxlie.SE3
    seconds: Float[Array, ""]
    timing: SensorTiming

    def at(self, T_target_source: jaxlie.SE3) -> RowMotion:
        """The motion of the rows, if this were the frame's pose."""
        known = self.seconds > 0
        moved = se3.log(se3.compose(se3.inverse(self.T_target_before), T_target_source))
        twist = moved / jnp.where(known, self.seconds, 1)
        return RowMotion(jnp.where(known, twist, 0), self.timing, known)
