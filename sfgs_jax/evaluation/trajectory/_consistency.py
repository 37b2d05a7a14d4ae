"""Do the covariances of a trajectory cover its errors?

Source: Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), 5.4.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from sfgs_jax.arrays import InputError, checked, described
from sfgs_jax.evaluation.trajectory._trajectory_metrics import paired
from sfgs_jax.geometry import Trajectory, se3


@dataclass(frozen=True)
class Nees:
    """Normalised estimation errors squared, e' C^-1 e; a covariance C that is right makes their mean 6.

    Attributes:
        timestamps: the estimate's time stamps, seconds.
        errors: tangents from the estimate to the truth, relative to the first pose; metres and radians.
        covariances: of these, as the estimate has them.
    """

    timestamps: Float[np.ndarray, " n"]
    errors: Float[np.ndarray, "n 6"]
    covariances: Float[np.ndarray, "n 6 6"]

    @property
    def squares(self) -> Float[np.ndarray, " n"]:
        """The normalised square of each pose's error."""
        solved = np.linalg.solve(self.covariances, self.errors[..., None])[..., 0]
        return np.sum(self.errors * solved, axis=1)

    @property
    def mean(self) -> float:
        """Mean of the squares."""
        return float(self.squares.mean())

    def share_within(self, sigmas: float) -> float:
        """Share of the poses whose error is no less likely than that many standard deviations of a number.

        Args:
            sigmas: standard deviations.
        """
        return float(np.mean(self.squares < chi2.ppf(chi2.cdf(sigmas**2, 1), 6)))


@checked
def nees(
    estimate: Trajectory,
    covariances: Float[np.ndarray, "n 6 6"],
    reference: Trajectory,
    *,
    max_difference_s: float = 0.02,
) -> Nees:
    """Errors of poses relative to the first one, in their own standard deviations.

    Args:
        estimate: n poses; the first is the world frame of the covariances.
        covariances: of the poses' tangents on the right, translation first; metres and radians.
        reference: ground truth, in its world frame.
        max_difference_s: limit on the difference of paired time stamps, seconds.

    Raises:
        InputError: fewer than two poses have a reference pose in time, or there is not one covariance a pose.
    """
    if len(covariances) != len(estimate):
        raise InputError(
            f"covariances of nees should be (n, 6, 6) for the {len(estimate)} poses, not "
            f"{described(covariances)}."
        )
    estimated, true, rows = paired(estimate, reference, max_difference_s, at_least=2)
    origin = estimated.poses[0] @ np.linalg.inv(true.poses[0])
    off = np.linalg.inv(estimated.poses) @ origin @ true.poses
    return Nees(estimated.timestamps[1:], se3.logs_of(off)[1:], np.asarray(covariances, float)[rows][1:])
