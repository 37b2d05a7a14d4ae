"""The faults of `experiments.recording_faults` are what they are called."""

import numpy as np
import pytest

from experiments.recording_faults import FAULTS, Faulty, outcome
from sfgs_jax.datasets import Recording, SyntheticRecording


@pytest.fixture(scope="module")
def recording() -> SyntheticRecording:
    return SyntheticRecording(num_frames=40, width=80, height=60)


def test_faults_change_what_they_should(recording):
    late = Faulty(recording, FAULTS["depth 3 frames late"])
    assert isinstance(late, Recording)
    np.testing.assert_array_equal(late[5].depth, recording[2].depth)
    np.testing.assert_array_equal(late[5].rgb, recording[5].rgb)
    truth, poses = recording.ground_truth.poses, Faulty(recording, FAULTS["poses 3 frames late"])
    np.testing.assert_array_equal(poses.ground_truth.poses[5], truth[2])
    ros = Faulty(recording, FAULTS["poses of a ROS body"]).ground_truth.poses[5]
    np.testing.assert_allclose(ros[:3, 0], truth[5][:3, 2])  # its x looks ahead
    np.testing.assert_allclose(ros[:3, 2], -truth[5][:3, 1])  # its z is up


@pytest.mark.parametrize(
    ("label", "expected"), [("as it is", "no warning"), ("depth x 5", "named"), ("depth mirrored", "named")]
)
def test_outcomes_are_told(recording, label, expected):
    assert outcome(Faulty(recording, FAULTS[label]), FAULTS[label]) == expected
