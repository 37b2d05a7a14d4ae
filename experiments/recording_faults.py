"""Faults put into good recordings, and whether `sfgs-jax check` names each.

    python -m experiments.recording_faults [--recordings NAME ...] [--faults NAME ...]

A cell says "named" if the right question has a warning, "open" if `check` says that it can't tell, and
"missed" otherwise. For the recording as it is, it counts warnings: each is a false alarm.
"""

import argparse
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from experiments.starts import InMemory
from sfgs_jax.datasets import Recording, WrappedRecording, open_recording
from sfgs_jax.evaluation.recording_check import check_recording
from sfgs_jax.geometry import Frame, Trajectory

DATA = Path(os.environ.get("SFGS_DATA", "../shared")) / "data"

Change = Callable[[np.ndarray], np.ndarray]

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""Axes of OpenGL's cameras in those of OpenCV's."""
ROS_BODY = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
"""Axes of ROS bodies (x forward, y left, z up) in those of OpenCV's cameras, as columns."""


def same(array: np.ndarray) -> np.ndarray:
    return array


@dataclass(frozen=True)
class Fault:
    """A change to a recording.

    Attributes:
        question: of `check`, which should warn.
        depth: change of each depth image.
        late: frames by which depth comes late.
        pose: change of each pose.
        poses_late: frames by which poses come late.
        without_poses: leave the poses out.
    """

    question: str
    depth: Change = same
    late: int = 0
    pose: Change = same
    poses_late: int = 0
    without_poses: bool = False


def scaled(factor: float) -> Change:
    return lambda depth: depth * np.float32(factor)


SCALES = (5.0, 0.2, 1000.0, 0.001, 10.0)

FAULTS: dict[str, Fault] = {
    "as it is": Fault(""),
    "as it is, without poses": Fault("", without_poses=True),
    **{f"depth x {f:g}": Fault("depth scale", depth=scaled(f)) for f in SCALES},
    **{
        f"depth x {f:g}, without poses": Fault("depth scale", depth=scaled(f), without_poses=True)
        for f in SCALES
    },
    "depth mirrored": Fault("depth layout", depth=lambda depth: depth[:, ::-1]),
    "depth upside down": Fault("depth layout", depth=lambda depth: depth[::-1]),
    "poses in OpenGL's axes": Fault("poses", pose=lambda pose: pose @ OPENGL),
    "poses of a ROS body": Fault("poses", pose=lambda pose: pose @ ROS_BODY),
    "poses world to camera": Fault("poses", pose=np.linalg.inv),
    **{f"depth {n} frames late": Fault("synchronisation", late=n) for n in (1, 3, 10)},
    "depth 2 frames early": Fault("synchronisation", late=-2),
    **{f"poses {n} frames late": Fault("poses", poses_late=n) for n in (3, 6)},
}


@dataclass(frozen=True)
class Faulty(WrappedRecording):
    """A recording with a fault.

    Attributes:
        recording: without it.
        fault: what is wrong with it.
    """

    fault: Fault

    @property
    def ground_truth(self) -> Trajectory | None:
        truth = self.recording.ground_truth
        if truth is None or self.fault.without_poses:
            return None
        poses = np.stack([self.fault.pose(pose) for pose in truth.poses])
        late = self.fault.poses_late
        return Trajectory(truth.timestamps, np.concatenate([poses[:1].repeat(late, 0), poses])[: len(poses)])

    def __getitem__(self, index: int) -> Frame:
        other = min(max(index - self.fault.late, 0), len(self) - 1)
        depth = self.fault.depth(np.asarray(self.recording[other].depth))
        return replace(self.recording[index], depth=np.ascontiguousarray(depth, np.float32))


def outcome(recording: Recording, fault: Fault) -> str:
    """What `check` makes of a recording with a fault."""
    check = check_recording(recording)
    if not fault.question:
        return ", ".join(finding.question for finding in check.warnings) or "no warning"
    severity = {finding.question: finding.severity for finding in check.findings}.get(fault.question)
    return {"warning": "named", "unknown": "open"}.get(str(severity), "missed")


def sources() -> dict[str, str]:
    return {
        "redkitchen": str(DATA / "7scenes" / "redkitchen"),
        "fr1_rpy": str(DATA / "tum" / "rgbd_dataset_freiburg1_rpy"),
        "tartanair": str(DATA / "tartanair" / "hospital_clip"),
        **{
            place: f"synthetic:place={place},frames=200,width=160,height=120,noise=1"
            for place in ("room", "twins", "wall", "sphere")
        },
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    known = sources()
    parser.add_argument("--recordings", nargs="+", choices=known, default=list(known))
    parser.add_argument("--faults", nargs="+", choices=FAULTS, default=list(FAULTS))
    arguments = parser.parse_args()
    columns = {}
    for name in arguments.recordings:
        recording = InMemory(open_recording(known[name]))
        columns[name] = {
            label: outcome(Faulty(recording, FAULTS[label]), FAULTS[label]) for label in arguments.faults
        }
    print("| fault |" + "".join(f" {name} |" for name in columns))
    print("| --- |" + " --- |" * len(columns))
    for label in arguments.faults:
        print(f"| {label} |" + "".join(f" {column[label]} |" for column in columns.values()))


if __name__ == "__main__":
    main()
