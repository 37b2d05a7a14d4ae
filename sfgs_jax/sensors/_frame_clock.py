"""The clock that a camera takes its frames by, from time stamps that jitter.

A sensor exposes its frames at even intervals. A driver stamps them when they arrive, some milliseconds early
or late. A motion divided by the time between two stamps is then off by as much as a tenth.

Source: Olson, A Passive Solution to the Sensor Synchronization Problem (IROS 2010), for the model; the period
is a straight line's slope by least squares, over all stamps first, then with a memory that fades.
"""

from dataclasses import dataclass

from sfgs_jax.arrays import pytree

_MEMORY = 30
"""Stamps that the period rests on."""
_OUT_OF_STEP = 0.3
"""Distance of a stamp from the clock, as a share of the period, beyond which the clock begins anew."""
_CONFIRMED = 10
"""Stamps in step from which on the clock is believed; before, the stamps are. Intervals that are uneven in
truth seldom stay in step for so long."""


@pytree
@dataclass(frozen=True)
class FrameClock:
    """Clock of a camera's frames; without arguments the one before the first frame.

    Frames that are missing are left out by the clock too: an interval is a whole number of periods.

    Attributes:
        stamp: time stamp of the newest frame, seconds.
        time: the same by the clock, seconds.
        period: from frame to frame, seconds; 0 while unknown.
        count: stamps in step so far, up to those that the period rests on; 0 before the first frame.
        elapsed: seconds from the frame before to the newest one; 0 where unknown.
    """

    stamp: float = 0.0
    time: float = 0.0
    period: float = 0.0
    count: int = 0
    elapsed: float = 0.0

    def after(self, stamp: float) -> "FrameClock":
        """The clock after another frame.

        Args:
            stamp: its time stamp, seconds, not before that of the newest frame.
        """
        since = stamp - self.stamp if self.count else 0.0
        ticks = max(1, round((stamp - self.time) / self.period)) if self.period else 1
        late = stamp - self.time - ticks * self.period
        if not self.period or abs(late) > _OUT_OF_STEP * self.period:
            return FrameClock(stamp, stamp, since, 2 if since else 1, since)
        count = min(self.count + 1, _MEMORY)
        time = self.time + ticks * self.period + late * 2 * (2 * count - 1) / (count * (count + 1))
        period = self.period + late / ticks * 6 / (count * (count + 1))
        return FrameClock(stamp, time, period, count, since if count <= _CONFIRMED else ticks * period)
