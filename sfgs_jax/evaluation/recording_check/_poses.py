"""Do given poses tell the motion that the images show: in these axes, at these times, in this unit?"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sfgs_jax.evaluation.recording_check._finding import Finding
from sfgs_jax.evaluation.recording_check._frame_pairs import PairMotion
from sfgs_jax.evaluation.recording_check._pose_lag import FARTHEST_LAG, find_pose_lag
from sfgs_jax.evaluation.recording_check._pose_motions import (
    AS_GIVEN,
    Convention,
    PoseScale,
    pose_motions,
    poses_by_frame,
)
from sfgs_jax.evaluation.recording_check._sample import RecordingSample

_FEWEST = 4
_GOOD = 0.35
"""Largest share of the motion that good poses leave unexplained."""

_AXES = {
    (1, -2, -3): "in the camera axes of OpenGL and Blender (x right, y up, z backward)",
    (3, -1, -2): "in the axes of ROS bodies (x forward, y left, z up)",
}
"""Names of camera axes: for x, y and z of the given camera, its OpenCV axis from 1, signed."""


@dataclass(frozen=True)
class PoseCheck:
    """How the poses fit.

    Attributes:
        finding: on axes and times.
        scale: of depth in the unit of the poses; None if it can't be told.
    """

    finding: Finding
    scale: PoseScale | None = None


def check_poses(sample: RecordingSample, motions: Sequence[PairMotion]) -> PoseCheck | None:
    """Compare motions by keypoints and depth with those of the given poses.

    Args:
        sample: of the recording.
        motions: of pairs of its frames.

    Returns:
        None if the recording has no poses.
    """
    truth = sample.recording.ground_truth
    if truth is None:
        return None
    poses = poses_by_frame(truth, sample.recording.timestamps)
    found = pose_motions(poses, motions)
    if len(found.measured) < _FEWEST or not np.isfinite(plain := found.unexplained(AS_GIVEN)):
        message = "It can't be told whether the poses fit: too few frames with a pose show a clear motion."
        return PoseCheck(Finding("poses", "unknown", message))
    evidence: dict[str, float | int] = {"unexplained share of motion": plain}
    if plain < _GOOD:
        if (late := find_pose_lag(poses, motions)) is not None:
            evidence |= {"gain by the lag": late.gain, "sigmas": late.sigmas}
            lagging = pose_motions(poses, motions, lag=late.frames)
            return PoseCheck(_lag_finding(late.frames, evidence), lagging.scale(AS_GIVEN))
        message = f"Poses agree with the motion of the images ({100 * plain:.0f} % unexplained)."
        return PoseCheck(Finding("poses", "good", message, evidence=evidence), found.scale(AS_GIVEN))
    best = min(_conventions(), key=found.unexplained)
    cost = found.unexplained(best)
    if cost < min(_GOOD, 0.6 * plain):
        evidence["as corrected"] = cost
        return PoseCheck(_convention_finding(best, plain, cost, evidence), found.scale(best))
    lags = {lag: pose_motions(poses, motions, lag=lag) for lag in range(-FARTHEST_LAG, FARTHEST_LAG + 1)}
    costs = {lag: at.unexplained(AS_GIVEN) for lag, at in lags.items() if len(at.measured) >= _FEWEST}
    lag = min(costs, key=lambda key: np.nan_to_num(costs[key], nan=1.0))
    if lag and costs[lag] < min(_GOOD, 0.6 * plain):
        return PoseCheck(
            _lag_finding(lag, evidence | {"as corrected": costs[lag]}), lags[lag].scale(AS_GIVEN)
        )
    return PoseCheck(
        Finding(
            "poses",
            "warning",
            f"Poses leave {100 * plain:.0f} % of the motion of the images unexplained, under "
            f"{100 * _GOOD:.0f} % is expected; no other axes and no other times fit.",
            "Check that the poses are of these images, and that quaternions are stored as x, y, z, w.",
            evidence,
        )
    )


def _conventions() -> list[Convention]:
    """All signed permutations of axes, camera to world and world to camera."""
    conventions = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            axes = np.zeros((3, 3))
            axes[order, range(3)] = signs
            conventions += [Convention(inverse, axes) for inverse in (False, True)]
    return conventions


def _convention_finding(
    convention: Convention, plain: float, cost: float, evidence: dict[str, float | int]
) -> Finding:
    advice = []
    if convention.inverse:
        advice.append("invert each pose")
    if not np.array_equal(convention.axes, np.eye(3)):
        rows = ", ".join(str([round(float(value)) for value in row]) for row in convention.axes.T)
        advice.append(f"multiply its rotation on the right by [{rows}]")
    mirrored = np.linalg.det(convention.axes) < 0
    if mirrored:
        advice = ["mirror the poses' world, which is left-handed"]
    return Finding(
        "poses",
        "warning",
        f"Poses are {_text(convention)}: so they leave {100 * cost:.0f} % of the motion unexplained, and "
        f"{100 * plain:.0f} % as camera to world in the axes of OpenCV, which is expected.",
        " and ".join(advice).capitalize() + ".",
        evidence,
    )


def _text(convention: Convention) -> str:
    words = ["world to camera"] if convention.inverse else []
    if not np.array_equal(convention.axes, np.eye(3)):
        places = np.abs(convention.axes).argmax(axis=0)
        x, y, z = (int(place + 1) * int(convention.axes[place, i]) for i, place in enumerate(places))
        signed = (x, y, z)
        words.append(_AXES.get(signed, "in other camera axes: " + _directions(signed)))
    return ", ".join(words) or "as expected"


def _directions(signed: tuple[int, int, int]) -> str:
    names = {1: "right", -1: "left", 2: "down", -2: "up", 3: "forward", -3: "backward"}
    return ", ".join(f"{axis} {names[place]}" for axis, place in zip("xyz", signed, strict=True))


def _lag_finding(lag: int, evidence: dict[str, float | int]) -> Finding:
    word = "late" if lag > 0 else "early"
    return Finding(
        "poses",
        "warning",
        f"Poses come {abs(lag)} frame{'s' if abs(lag) > 1 else ''} {word} against the images; 0 is expected.",
        f"Give each frame the pose {abs(lag)} places {'after' if lag > 0 else 'before'} its own, or correct "
        "the times of the poses.",
        evidence | {"frames late": lag},
    )
