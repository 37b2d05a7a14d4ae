"""Errors of an estimated trajectory against a reference: absolute (ATE) and relative (RPE).

Source: Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from sfgs_jax.arrays import InputError, checked
from sfgs_jax.datasets import associate
from sfgs_jax.evaluation.trajectory._alignment import Alignment, align_points
from sfgs_jax.geometry import Trajectory


@dataclass(frozen=True)
class Ate:
    """Absolute trajectory error: distances between aligned positions.

    Attributes:
        rmse_m: root of the mean squared distance, metres.
        mean_m: mean distance, metres; some papers print this as "ATE RMSE".
        median_m: median distance, metres.
        max_m: largest distance, metres.
        num_pairs: number of poses that were compared.
        alignment: the motion from the estimate's world frame to the reference's.
        timestamps: the estimate's time stamps, seconds.
        errors_m: distance at each time stamp, metres.
    """

    rmse_m: float
    mean_m: float
    median_m: float
    max_m: float
    num_pairs: int
    alignment: Alignment
    timestamps: Float[np.ndarray, " num_pairs"]
    errors_m: Float[np.ndarray, " num_pairs"]

    @property
    def T_reference_estimate(self) -> Float[np.ndarray, "4 4"]:
        """Motion from the estimate's world frame to the reference's."""
        return self.alignment.T_target_source


@dataclass(frozen=True)
class Rpe:
    """Relative pose error: error of the motion over a fixed number of poses.

    Attributes:
        trans_m: root of the mean squared translation error, metres.
        rot_deg: root of the mean squared rotation error, degrees.
        num_pairs: number of motions that were compared.
        delta: number of poses that a motion spans.
    """

    trans_m: float
    rot_deg: float
    num_pairs: int
    delta: int


@checked
def ate(
    estimate: Trajectory,
    reference: Trajectory,
    *,
    max_difference_s: float = 0.02,
    with_scale: bool = False,
) -> Ate:
    """Absolute trajectory error after the best rigid alignment of the positions.

    Args:
        estimate: poses in the estimate's own world frame.
        reference: ground truth, in its world frame.
        max_difference_s: limit on the difference of paired time stamps, seconds.
        with_scale: also estimate a scale, as for a camera without depth.

    Raises:
        InputError: fewer than three poses have a reference pose in time.
    """
    estimated, true, _ = paired(estimate, reference, max_difference_s, at_least=3)
    alignment = align_points(estimated.positions, true.positions, with_scale=with_scale)
    errors = np.linalg.norm(alignment.transform(estimated.positions) - true.positions, axis=1)
    return Ate(
        rmse_m=float(np.sqrt(np.mean(errors**2))),
        mean_m=float(np.mean(errors)),
        median_m=float(np.median(errors)),
        max_m=float(np.max(errors)),
        num_pairs=len(errors),
        alignment=alignment,
        timestamps=estimated.timestamps,
        errors_m=errors,
    )


@checked
def rpe(
    estimate: Trajectory, reference: Trajectory, *, delta: int = 1, max_difference_s: float = 0.02
) -> Rpe:
    """Relative pose error over `delta` poses, over all overlapping pairs.

    Only poses with a reference in time count, so a motion across lost frames spans more time.

    Args:
        estimate: poses in the estimate's own world frame; no alignment is needed.
        reference: ground truth, in its world frame.
        delta: number of poses that a motion spans, at least 1.
        max_difference_s: limit on the difference of paired time stamps, seconds.

    Raises:
        InputError: not even one motion can be compared, or `delta` is not positive.
    """
    if delta < 1:
        raise InputError(f"The relative error goes over delta poses, at least 1: {delta} makes no motion.")
    estimated, true, _ = paired(estimate, reference, max_difference_s, at_least=delta + 1)
    errors = np.linalg.inv(_relative(true.poses, delta)) @ _relative(estimated.poses, delta)
    distances = np.linalg.norm(errors[:, :3, 3], axis=1)
    angles = np.degrees(_angles(errors[:, :3, :3]))
    return Rpe(
        trans_m=float(np.sqrt(np.mean(distances**2))),
        rot_deg=float(np.sqrt(np.mean(angles**2))),
        num_pairs=len(errors),
        delta=delta,
    )


def paired(
    estimate: Trajectory, reference: Trajectory, max_difference_s: float, at_least: int
) -> tuple[Trajectory, Trajectory, Int[np.ndarray, " k"]]:
    """Estimated poses with their reference poses, in order of time, and the estimate's rows of these.

    Args:
        estimate: poses, in any order.
        reference: poses, in any order.
        max_difference_s: limit on the difference of paired time stamps, seconds.
        at_least: pairs that are needed.

    Raises:
        InputError: there are fewer pairs.
    """
    order = np.argsort(estimate.timestamps, kind="stable")
    estimate, reference = estimate[order], reference[np.argsort(reference.timestamps, kind="stable")]
    pairs = associate(estimate.timestamps, reference.timestamps, max_difference_s)
    if len(pairs) < at_least:
        raise InputError(
            f"Only {len(pairs)} of {len(estimate)} estimated poses have a reference pose within "
            f"{max_difference_s} s, and {at_least} are needed: check that both use the same clock."
        )
    return estimate[pairs[:, 0]], reference[pairs[:, 1]], order[pairs[:, 0]]


def _relative(poses: Float[np.ndarray, "n 4 4"], delta: int) -> Float[np.ndarray, "m 4 4"]:
    return np.linalg.inv(poses[:-delta]) @ poses[delta:]


def _angles(rotations: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, " n"]:
    """Rotation angles in radians, by atan2: arccos loses half the digits of a small angle."""
    axis = np.stack(
        [
            rotations[:, 2, 1] - rotations[:, 1, 2],
            rotations[:, 0, 2] - rotations[:, 2, 0],
            rotations[:, 1, 0] - rotations[:, 0, 1],
        ],
        axis=1,
    )
    return np.arctan2(np.linalg.norm(axis, axis=1), np.trace(rotations, axis1=1, axis2=2) - 1)
