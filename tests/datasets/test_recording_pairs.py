"""Pairs of frames within limits of distance and angle."""

from dataclasses import dataclass

import cv2
import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import ReaderOptions, open_recording, recording_pairs
from sfgs_jax.geometry import Camera, Frame, Trajectory


@dataclass(frozen=True)
class Line:
    """A recording of 20 frames: 6 cm to the right and 2 degrees about the y axis from one to the next."""

    ground_truth: Trajectory | None
    name: str = "line"
    dataset: str = "folder"
    notes: tuple[str, ...] = ()

    @property
    def camera(self) -> Camera:
        return Camera(1.0, 1.0, 0.0, 0.0, width=1, height=1)

    @property
    def timestamps(self) -> np.ndarray:
        return np.arange(20) / 30

    def __len__(self) -> int:
        return 20

    def __getitem__(self, index: int) -> Frame:
        raise AssertionError("Pairs are chosen by the poses; no frame is read.")


def poses() -> np.ndarray:
    result = np.tile(np.eye(4), (20, 1, 1))
    for i, pose in enumerate(result):
        pose[:3, :3] = cv2.Rodrigues(np.array([0, np.radians(2 * i), 0]))[0]
        pose[0, 3] = 0.06 * i
    return result


def test_pairs_within_limits_by_gap_and_frame():
    recording = Line(Trajectory(np.arange(20) / 30, poses()))
    pairs = recording_pairs(recording, gaps=(1, 2, 4, 8), stride=5, max_distance=0.3, max_angle_deg=45.0)
    # One frame apart is too near at 6 cm, eight too far at 48.
    assert [(pair.index_a, pair.index_b) for pair in pairs] == [
        (a, a + gap) for gap in (2, 4) for a in range(0, 20 - gap, 5)
    ]
    assert pairs[0].gap == 2
    turned = recording_pairs(recording, gaps=(2, 4), stride=5, max_angle_deg=5.0)
    assert {pair.gap for pair in turned} == {2}
    pair = pairs[1]
    point = np.array([0.3, -0.2, 2.0, 1])
    np.testing.assert_allclose(poses()[pair.index_b] @ pair.T_b_a @ point, poses()[pair.index_a] @ point)


def test_frames_without_a_pose_are_in_no_pair():
    known = np.array([i for i in range(20) if i != 7])
    recording = Line(Trajectory(known / 30, poses()[known]))
    pairs = recording_pairs(recording, gaps=(3,), stride=1)
    assert [pair.index_a for pair in pairs] == [a for a in range(17) if a not in (4, 7)]


def test_what_has_no_pairs_is_refused():
    with pytest.raises(InputError, match="no ground-truth poses"):
        recording_pairs(Line(None))
    recording = Line(Trajectory(np.arange(20) / 30, poses()))
    with pytest.raises(InputError, match=r"No frames of line that are 30, 40 apart"):
        recording_pairs(recording, gaps=(30, 40))
    with pytest.raises(InputError, match="at least 1"):
        recording_pairs(recording, gaps=(0,))


def test_redkitchen_has_its_123_pairs(sfgs_data):
    recording = open_recording(
        sfgs_data / "data/7scenes/redkitchen", options=ReaderOptions(start=300, end=600)
    )
    pairs = recording_pairs(recording)
    assert len(pairs) == 123
    for pair in pairs:
        assert 0.1 <= np.linalg.norm(pair.T_b_a[:3, 3]) < 2
