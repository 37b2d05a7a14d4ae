"""Sum of what the frames so far say about the times of the camera's rows.

An error of depth that moves with the camera, such as a depth camera beside its place, looks much like late
depth. So frames tell of the times and of depth's errors together. What they tell of the times alone is what
is left when depth's errors are as unknown as the keyframes leave them.
"""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import Precision
from jaxtyping import Array, Float

from sfgs_jax.sensors import SensorTiming

_ROUNDING = 1e-6
"""Share of the largest information about depth's errors that float32 may have added up wrongly."""


class TimingPrior(NamedTuple):
    """What is known without the frames.

    Attributes:
        sigmas: (3,) standard deviations of the times, seconds.
        depth_root: (G, G) lower Cholesky factor of the covariance of depth's errors; see
            `TrackerParams.depth_root`.
    """

    sigmas: Float[Array, "3"]
    depth_root: Float[Array, "G G"]


class TimingInformation(eqx.Module):
    """Normal equations of the three times of a `SensorTiming` and of G errors of depth, n = 3 + G.

    The unknowns are differences: of the times from those that the estimate started from, and of the
    parameters of the `DepthCorrection` from those in use.

    Attributes:
        information: (n, n) of the sum, the prior not among it; of times 1 / s².
        vector: (n,) right-hand side.
        most_likely: (n,) differences by the sum and the prior.
        of_times: (3, 3) information about the times, depth's errors known by their prior alone; 1 / s².
        chi_square: sum over the registrations of the squared surprise: how far the estimate before was from
            what the registration said of the times, in the latter's standard deviations.
        expected: what that sum would be if registrations were as good as their information says.
    """

    information: Float[Array, "n n"]
    vector: Float[Array, " n"]
    most_likely: Float[Array, " n"]
    of_times: Float[Array, "3 3"]
    chi_square: Float[Array, ""]
    expected: Float[Array, ""]

    def estimate(self, start: SensorTiming) -> SensorTiming:
        """Most likely times.

        Args:
            start: mean of the prior.
        """
        return SensorTiming.of_vector(start.vector + self.most_likely[:3])

    def covariance(self, sigmas: Float[Array, "3"]) -> Float[Array, "3 3"]:
        """(3, 3) covariance of the estimated times, s²; larger where registrations contradict each other.

        Args:
            sigmas: (3,) standard deviations of the prior, seconds.
        """
        excess = self.chi_square / jnp.where(self.expected > 0, self.expected, 1)
        scaled = _scaled(self.of_times / jnp.maximum(excess, 1), sigmas)
        return sigmas[:, None] * jnp.linalg.inv(scaled) * sigmas[None]

    def plus(
        self, information: Float[Array, "n n"], vector: Float[Array, " n"], prior: TimingPrior
    ) -> "TimingInformation":
        """The sum with a registration's equations.

        Args:
            information: (n, n) of one registration.
            vector: (n,) its right-hand side.
            prior: of times and depth's errors.
        """
        scale = prior.sigmas[:, None] * prior.sigmas[None]
        told = information[:3, :3] * scale
        off = vector[:3] - jnp.matmul(information[:3], self.most_likely, precision=Precision.HIGHEST)
        off = off * prior.sigmas
        inverse = jnp.linalg.inv(told + jnp.eye(3, dtype=told.dtype))
        surprise = jnp.matmul(off, jnp.matmul(inverse, off, precision=Precision.HIGHEST))
        total = replace(
            self,
            information=self.information + information,
            vector=self.vector + vector,
            chi_square=self.chi_square + surprise,
            expected=self.expected + jnp.sum(inverse * told),
        )
        return total.solved(prior)

    def solved(self, prior: TimingPrior) -> "TimingInformation":
        """The same with what follows from the sum.

        Args:
            prior: of times and depth's errors.
        """
        (sigmas, root), high = prior, Precision.HIGHEST
        # Depth's errors in units of what is known of them, so that float32 is enough.
        about_depth = jnp.matmul(root.T, self.information[3:], precision=high)
        inner = jnp.matmul(about_depth[:, 3:], root, precision=high)
        prior_weight = 1 + _ROUNDING * jnp.max(jnp.diagonal(inner), initial=0)
        inner = inner + prior_weight * jnp.eye(len(inner), dtype=inner.dtype)
        right = jnp.concatenate(
            [about_depth[:, :3], jnp.matmul(root.T, self.vector[3:], precision=high)[:, None]], axis=1
        )
        by_times = jax.scipy.linalg.solve(inner, right, assume_a="pos")
        left = jnp.concatenate([self.information[:3, :3], self.vector[:3, None]], axis=1)
        left = left - jnp.matmul(right[:, :3].T, by_times, precision=high)
        times = sigmas * jax.scipy.linalg.solve(
            _scaled(left[:, :3], sigmas), sigmas * left[:, 3], assume_a="pos"
        )
        depth = by_times[:, 3] - jnp.matmul(by_times[:, :3], times, precision=high)
        most_likely = jnp.concatenate([times, jnp.matmul(root, depth, precision=high)])
        return replace(self, most_likely=most_likely, of_times=left[:, :3])

    def counted_from(self, ahead: Float[np.ndarray, " n"]) -> "TimingInformation":
        """The same equations of differences from other times and parameters, on the host.

        Args:
            ahead: (n,) these, less those before.
        """
        information, vector, most_likely = map(np.asarray, (self.information, self.vector, self.most_likely))
        ahead = ahead.astype(vector.dtype)
        after = jax.device_put((vector - information @ ahead, most_likely - ahead))
        return eqx.tree_at(lambda t: (t.vector, t.most_likely), self, after)

    def joined(self, other: "TimingInformation", prior: TimingPrior) -> "TimingInformation":
        """The sum with that of other registrations of the same camera.

        Args:
            other: sum over these, counted from the same times and parameters.
            prior: of times and depth's errors.
        """
        return jax.tree.map(jnp.add, self, other).solved(prior)


def no_timing_information(num_depth_parameters: int, dtype: np.dtype) -> TimingInformation:
    """Nothing, as before the first registration.

    Args:
        num_depth_parameters: G.
        dtype: of its numbers.
    """
    n = 3 + num_depth_parameters
    shapes = (n, n), (n,), (n,), (3, 3), (), ()
    return TimingInformation(*[jax.device_put(np.zeros(shape, dtype)) for shape in shapes])


def _scaled(information: Float[Array, "3 3"], sigmas: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Information with the prior's, in the prior's standard deviations."""
    return information * (sigmas[:, None] * sigmas[None]) + jnp.eye(3, dtype=sigmas.dtype)
