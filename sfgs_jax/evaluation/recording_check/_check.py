"""All questions about a recording, in an order in which one answer helps the next."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sfgs_jax.datasets import Recording, Selection
from sfgs_jax.datasets.files import FileRecording
from sfgs_jax.evaluation.recording_check._blur import check_blur
from sfgs_jax.evaluation.recording_check._depth_coverage import check_coverage
from sfgs_jax.evaluation.recording_check._depth_place import check_depth_place, placed
from sfgs_jax.evaluation.recording_check._depth_scale import check_scale_by_habit, check_scale_by_poses
from sfgs_jax.evaluation.recording_check._exposure import check_exposure
from sfgs_jax.evaluation.recording_check._finding import Finding
from sfgs_jax.evaluation.recording_check._frame_pairs import FramePair, PairMotion, frame_pairs, motion_of
from sfgs_jax.evaluation.recording_check._frames import check_frames, check_repeats, check_times
from sfgs_jax.evaluation.recording_check._intrinsics import check_intrinsics
from sfgs_jax.evaluation.recording_check._poses import PoseCheck, check_poses
from sfgs_jax.evaluation.recording_check._sample import RecordingSample, sample_recording, with_focal_factor


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


def check_recording(
    recording: Recording, *, progress: Callable[[int, int], object] | None = None
) -> RecordingCheck:
    """Look for what would spoil a run of a recording, in a sample of its frames.

    Args:
        recording: at least one frame.
        progress: called as `progress(done, total)` with numbers of frames.

    Raises:
        InputError: none of the frames can be read.
    """
    sample = sample_recording(recording, progress)
    pairs = frame_pairs(sample)
    place = check_depth_place(sample)
    motions = _motions(pairs, sample, place.layout)
    intrinsics = check_intrinsics(sample, [motion for _, motion in motions], measured=place.in_place)
    poses = check_poses(sample, motions)
    if intrinsics.focal_factor != 1:
        # A wrong focal length bends the motions, and then would be blamed on the poses as well.
        corrected = with_focal_factor(sample, intrinsics.focal_factor)
        corrected_motions = _motions(pairs, corrected, place.layout)
        corrected_poses = check_poses(corrected, corrected_motions)
        if _contradict(poses, corrected_poses):
            # A rolling shutter bends motions as well.
            intrinsics = check_intrinsics(sample, [], measured=False)
        else:
            motions, poses = corrected_motions, corrected_poses
    findings = [
        check_frames(sample),
        check_times(sample, pairs),
        check_repeats(sample),
        check_exposure(sample),
        check_blur(sample),
        check_coverage(sample),
        *place.findings,
        *intrinsics.findings,
        _scale(sample, motions, poses, in_place=place.in_place),
    ]
    if poses is not None:
        findings.append(poses.finding)
    return RecordingCheck(recording.name, recording.dataset, recording.notes, tuple(findings))


def _contradict(as_given: PoseCheck | None, corrected: PoseCheck | None) -> bool:
    """Whether poses fit with the given focal length, and worse with the corrected one."""
    if as_given is None or corrected is None or as_given.finding.severity != "good":
        return False
    name = "unexplained share of motion"
    return as_given.finding.evidence[name] < corrected.finding.evidence.get(name, 1.0)


def _motions(pairs: Sequence[FramePair], sample: RecordingSample, layout: str) -> list[PairMotion]:
    """Motions of the pairs that have one, by depth turned to where it belongs."""
    found = []
    for pair in pairs:
        motion = motion_of(pair, placed(pair.depth, layout), sample)
        if motion is not None:
            found.append((pair, motion))
    return found


def _scale(
    sample: RecordingSample, motions: Sequence[PairMotion], poses: PoseCheck | None, *, in_place: bool
) -> Finding:
    units = units_per_metre(sample.recording)
    if poses is None or poses.scale is None:
        return check_scale_by_habit(sample, motions, units)
    return check_scale_by_poses(poses.scale, units, float(np.median(sample.depths)), in_place=in_place)


def units_per_metre(recording: Recording) -> float | None:
    """Units of the depth images that the reader took; None where the layout has none or leaves it open.

    Args:
        recording: of any layout.
    """
    if isinstance(recording, Selection):
        recording = recording.recording
    return recording.units_per_metre if isinstance(recording, FileRecording) else None
