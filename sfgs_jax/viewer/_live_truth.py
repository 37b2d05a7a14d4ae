"""Ground truth beside the path of a run: aligned, with errors and the bounds that the run gives for them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from sfgs_jax.arrays import InputError
from sfgs_jax.evaluation import ate
from sfgs_jax.geometry import Trajectory


@dataclass(frozen=True)
class TruthBeside:
    """The true path in the run's world frame, and how far off the run is.

    Attributes:
        path: true poses up to the newest frame.
        rmse_m: absolute trajectory error, metres.
        rows: frames of the trajectory that have a true pose.
        errors_m: distance of their positions, metres.
    """

    path: Trajectory
    rmse_m: float
    rows: Int[np.ndarray, " k"]
    errors_m: Float[np.ndarray, " k"]


def truth_beside(trajectory: Trajectory, truth: Trajectory) -> TruthBeside | None:
    """Align the true path with the run's so far.

    Args:
        trajectory: of the run, in order of time.
        truth: ground truth, in its own world frame.

    Returns:
        None while fewer than three frames have a true pose.
    """
    try:
        found = ate(trajectory, truth)
    except InputError:
        return None
    times = trajectory.timestamps
    now = truth[(truth.timestamps >= times[0]) & (truth.timestamps <= times[-1])]
    path = Trajectory(now.timestamps, np.linalg.inv(found.T_reference_estimate) @ now.poses)
    return TruthBeside(path, found.rmse_m, np.searchsorted(times, found.timestamps), found.errors_m)


def position_bounds(covariances: Float[np.ndarray, "n 6 6"]) -> Float[np.ndarray, " n"]:
    """Three standard deviations of positions, metres: of the distance from the true one.

    Args:
        covariances: of poses' tangents, translation first.
    """
    return 3 * np.sqrt(np.trace(covariances[:, :3, :3], axis1=1, axis2=2))
