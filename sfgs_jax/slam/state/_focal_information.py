"""Sum of what registrations say about the focal lengths."""

import math
from dataclasses import dataclass

from sfgs_jax.arrays import pytree

_USUAL_EXCESS = 3.0
"""Variance of what registrations say, over what their information says, until there are several."""
_USUAL_COUNT = 4.0
"""Registrations that this assumption counts as much as."""
_SIGMAS = 4.0
"""Standard deviations beyond which chance explains no error. With three, fr1_rpy at every fifth frame is
suspected."""
_LEAST_COUNT = 5.0
"""Registrations below which no error is believed: the first few are of one motion, and may err alike."""


@pytree
@dataclass(frozen=True)
class FocalInformation:
    """Normal equations of the logarithm of the focal lengths, summed over registrations, on the host.

    The unknown is their difference from those in use.

    Attributes:
        information: of the sum.
        vector: right-hand side.
        square: sum of the squares of what each registration says, times its information.
        count: registrations that are independent.
    """

    information: float = 0.0
    vector: float = 0.0
    square: float = 0.0
    count: float = 0.0

    @classmethod
    def of(cls, information: float, vector: float) -> "FocalInformation":
        """What one registration says; nothing if it knows nothing.

        Args:
            information: of its equation.
            vector: right-hand side.
        """
        if information <= 0:
            return cls()
        return cls(information, vector, vector**2 / information, 1.0)

    def of_which(self, share: float) -> "FocalInformation":
        """A share of what is said.

        Args:
            share: that no other registration says too.
        """
        return FocalInformation(
            share * self.information, share * self.vector, share * self.square, share * self.count
        )

    def joined(self, other: "FocalInformation") -> "FocalInformation":
        """The sum with that of other registrations of the same camera.

        Args:
            other: sum over these.
        """
        return FocalInformation(
            self.information + other.information,
            self.vector + other.vector,
            self.square + other.square,
            self.count + other.count,
        )

    def estimate(self) -> tuple[float, float]:
        """Logarithm of the true focal lengths over those in use, and its standard deviation.

        The deviation is the larger the more the registrations contradict each other; infinite without any.
        """
        if not self.count:
            return 0.0, float("inf")
        mean = self.vector / self.information
        chi_square = max(0.0, self.square - mean * self.vector)
        freedom = max(0.0, self.count - 1)
        excess = (chi_square + _USUAL_COUNT * _USUAL_EXCESS) / (freedom + _USUAL_COUNT)
        return mean, (max(1.0, excess) / self.information) ** 0.5

    def is_beyond(self, limit: float) -> bool:
        """True if the focal lengths are wrong by more than other errors and chance explain together.

        Args:
            limit: of what distorted depth and rolling shutters can make of right ones, as a share.
        """
        error, sigma = self.estimate()
        return bool(self.count >= _LEAST_COUNT and abs(error) > math.hypot(limit, _SIGMAS * sigma))
