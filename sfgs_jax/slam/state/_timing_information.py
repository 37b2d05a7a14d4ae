"""Sum of what the frames so far say about the times of the camera's rows."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import Precision
from jaxtyping import Array, Float

from sfgs_jax.sensors import SensorTiming


class TimingInformation(eqx.Module):
    """Normal equations of the three times of a `SensorTiming`, summed over registrations.

    The unknown is their difference from the times that the estimate started from.

    Attributes:
        information: (3, 3) of the sum, the prior not among it, 1 / s².
        vector: (3,) right-hand side, 1 / s.
        chi_square: sum over the registrations of the squared surprise: how far the estimate before was from
            what the registration said, in the latter's standard deviations.
        expected: what that sum would be if registrations were as good as their information says.
    """

    information: Float[Array, "3 3"]
    vector: Float[Array, "3"]
    chi_square: Float[Array, ""]
    expected: Float[Array, ""]

    def estimate(self, start: SensorTiming, sigmas: Float[Array, "3"]) -> SensorTiming:
        """Most likely times.

        Args:
            start: mean of the prior.
            sigmas: (3,) standard deviations of the prior, seconds.
        """
        return SensorTiming.of_vector(start.vector + self._difference(sigmas))

    def covariance(self, sigmas: Float[Array, "3"]) -> Float[Array, "3 3"]:
        """(3, 3) covariance of the estimate, s²; larger where registrations contradict each other.

        Args:
            sigmas: (3,) standard deviations of the prior, seconds.
        """
        excess = self.chi_square / jnp.where(self.expected > 0, self.expected, 1)
        scaled = self._scaled(sigmas, jnp.maximum(excess, 1))
        return sigmas[:, None] * jnp.linalg.inv(scaled) * sigmas[None]

    def plus(
        self, information: Float[Array, "3 3"], vector: Float[Array, "3"], sigmas: Float[Array, "3"]
    ) -> "TimingInformation":
        """The sum with a registration's equations.

        Args:
            information: (3, 3) of one registration, 1 / s².
            vector: (3,) its right-hand side, 1 / s.
            sigmas: (3,) standard deviations of the prior, seconds.
        """
        scale = sigmas[:, None] * sigmas[None]
        told = information * scale
        off = sigmas * vector - jnp.matmul(
            told, self._difference(sigmas) / sigmas, precision=Precision.HIGHEST
        )
        inverse = jnp.linalg.inv(told + jnp.eye(3, dtype=told.dtype))
        surprise = jnp.matmul(off, jnp.matmul(inverse, off, precision=Precision.HIGHEST))
        return TimingInformation(
            self.information + information,
            self.vector + vector,
            self.chi_square + surprise,
            self.expected + jnp.sum(inverse * told),
        )

    def joined(self, other: "TimingInformation", ahead: Float[np.ndarray, "3"]) -> "TimingInformation":
        """The sum with that of other registrations of the same camera, on the host.

        Args:
            other: sum over these.
            ahead: (3,) times that the other sum started from, less those that this one started from, seconds.
        """
        mine, theirs = (jax.tree.map(np.asarray, told) for told in (self, other))
        vector = mine.vector + theirs.vector + theirs.information @ ahead.astype(mine.vector.dtype)
        told = jax.tree.map(np.add, mine, theirs)
        return jax.device_put(eqx.tree_at(lambda t: t.vector, told, vector))

    def _scaled(self, sigmas: Float[Array, "3"], excess: Float[Array, ""]) -> Float[Array, "3 3"]:
        """Information with the prior's, in the prior's standard deviations."""
        scale = sigmas[:, None] * sigmas[None]
        return self.information * scale / excess + jnp.eye(3, dtype=sigmas.dtype)

    def _difference(self, sigmas: Float[Array, "3"]) -> Float[Array, "3"]:
        scaled = self._scaled(sigmas, jnp.ones((), sigmas.dtype))
        return sigmas * jax.scipy.linalg.solve(scaled, sigmas * self.vector, assume_a="pos")
