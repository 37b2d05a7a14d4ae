"""All questions about a recording, in an order in which one answer helps the next."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from sfgs_jax.datasets import Recording, Selection
from sfgs_jax.datasets.files import FileRecording
from sfgs_jax.evaluation.recording_check._blur import check_blur
from sfgs_jax.evaluation.recording_check._depth_coverage import check_coverage
from sfgs_jax.evaluation.recording_check._depth_place import LAYOUTS, check_depth_place
from sfgs_jax.evaluation.recording_check._depth_scale import check_scale_by_habit, check_scale_by_poses
from sfgs_jax.evaluation.recording_check._exposure import check_exposure
from sfgs_jax.evaluation.recording_check._finding import Finding
from sfgs_jax.evaluation.recording_check._frame_pairs import frame_pairs, motion_of
from sfgs_jax.evaluation.recording_check._frames import check_frames, check_repeats, check_times
from sfgs_jax.evaluation.recording_check._intrinsics import check_intrinsics
from sfgs_jax.evaluation.recording_check._poses import check_poses
from sfgs_jax.evaluation.recording_check._sample import sample_recording


@dataclass(frozen=True)
class RecordingCheck:
    """What was found in a recording.

    Attributes:
        name: of the recording.
        dataset: its layout.
        notes: of its reader.
        findings: one or more for each question.
    """

    name: str
    dataset: str
    notes: tuple[str, ...]
    findings: tuple[Finding, ...]

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """The findings that would spoil a run."""
        return tuple(finding for finding in self.findings if finding.severity == "warning")


def check_recording(recording: Recording) -> RecordingCheck:
    """Look for what would spoil a run of a recording, in a sample of its frames.

    Args:
        recording: at least one frame.

    Raises:
        InputError: none of the frames can be read.
    """
    sample = sample_recording(recording)
    place = check_depth_place(sample)
    pairs = frame_pairs(sample)
    upright = LAYOUTS[place.layout]
    found = [(pair, motion_of(pair, _placed(pair.first.depth, upright), sample)) for pair in pairs]
    moved = [(pair, motion) for pair, motion in found if motion is not None]
    pairs_moved, motions = [pair for pair, _ in moved], [motion for _, motion in moved]
    units = units_per_metre(recording)
    poses = check_poses(sample, pairs_moved, motions)
    if poses is not None and poses.scale is not None:
        scale = check_scale_by_poses(*poses.scale, units, float(np.median(sample.depths)))
    else:
        scale = check_scale_by_habit(sample, pairs_moved, motions, units)
    findings = [
        check_frames(sample),
        check_times(sample, pairs),
        check_repeats(sample),
        check_exposure(sample),
        check_blur(sample),
        check_coverage(sample),
        *place.findings,
        scale,
        *check_intrinsics(sample, motions),
    ]
    if poses is not None:
        findings.append(poses.finding)
    return RecordingCheck(recording.name, recording.dataset, recording.notes, tuple(findings))


def units_per_metre(recording: Recording) -> float | None:
    """Units of the depth images that the reader took; None where the layout has none or leaves it open.

    Args:
        recording: of any layout.
    """
    if isinstance(recording, Selection):
        recording = recording.recording
    return recording.units_per_metre if isinstance(recording, FileRecording) else None


def _placed(depth, transform):
    height, width = depth.shape
    size = np.array([width, height]) - 1
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    where = np.rint(transform(np.c_[u.ravel(), v.ravel()] / size) * size).astype(int)
    placed = np.zeros_like(depth)
    placed[where[:, 1], where[:, 0]] = depth.ravel()
    return placed
