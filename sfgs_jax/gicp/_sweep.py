"""Motion of a camera while it reads the rows of a depth image."""

import equinox as eqx
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Bool, Float

from sfgs_jax.geometry import se3
from sfgs_jax.sensors import SensorTiming

_LARGEST_SWING = 0.5
"""Share of a pose's error that may come back with the other sign in the next frame."""


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

    A surface whose depth is d seconds late lies d times the speed off. So a pose by it has -k / (1 + k) of
    the error of the pose before, with k = d / `seconds`. At half a frame before colour that is the whole
    error with the other sign, and poses would swing for ever. Beyond a third of a frame the motion before
    takes part, so that errors die out.

    Attributes:
        T_target_before: pose of the frame before.
        seconds: time since then; 0 where it is unknown, and then the camera counts as still.
        timing: times of the rows, relative to the frame's.
        before: the motion up to the frame before; None if nothing is known about it.
    """

    T_target_before: jaxlie.SE3
    seconds: Float[Array, ""]
    timing: SensorTiming
    before: RowMotion | None = None

    def at(self, T_target_source: jaxlie.SE3) -> RowMotion:
        """The motion of the rows, if this were the frame's pose."""
        known = self.seconds > 0
        moved = se3.log(se3.compose(se3.inverse(self.T_target_before), T_target_source))
        seconds = jnp.where(known, self.seconds, 1)
        twist = moved / seconds
        if self.before is not None:
            # -k / (1 + k) reaches the largest swing at this k; beyond it the share falls as k does.
            beyond = self.timing.depth_delay / seconds + _LARGEST_SWING / (1 + _LARGEST_SWING)
            share = jnp.where(self.before.known, 1 + jnp.clip(beyond, -1, 0), 1)
            twist = share * twist + (1 - share) * self.before.twist
        return RowMotion(jnp.where(known, twist, 0), self.timing, known)
