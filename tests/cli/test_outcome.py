"""A run that lost its way is no success; poses of another scale are named."""

import re

import pytest

from sfgs_jax.cli import failure_of, scale_warning
from sfgs_jax.datasets import SyntheticRecording
from sfgs_jax.geometry import Trajectory

RECORDING = SyntheticRecording(num_frames=40, width=80, height=60)


def test_an_empty_map_and_lost_frames_are_failures():
    metrics = {"frames": {"total": 45, "dropped": 5, "lost": 3}, "map": {"gaussians": 100}}
    assert failure_of(metrics, "desk") is None
    empty = metrics | {"map": {"gaussians": 0}}
    assert failure_of(empty, "desk").startswith("The map is empty: no Gaussian was made of 40 frames.")
    assert failure_of(empty, "desk").endswith("`sfgs-jax check desk` says what is wrong with the recording.")
    metrics["frames"]["lost"] = 4
    assert failure_of(metrics, "desk").startswith("4 of 40 frames were lost, a tenth or more.")
    told = "Focal lengths are about 2.5 % too long."
    assert failure_of(metrics, "desk", told) == f"4 of 40 frames were lost, a tenth or more. {told}"


def test_the_frames_that_confirm_a_place_of_an_earlier_map_are_no_failure():
    frames = {"total": 40, "dropped": 0, "lost": 4}
    metrics = {"frames": frames, "map": {"gaussians": 100}}
    assert failure_of(metrics, "desk", confirming=4) is None
    frames["lost"] = 8
    assert failure_of(metrics, "desk", confirming=4).startswith("8 of 40 frames were lost, a tenth or more.")
    # A recording in which no frame was tracked is none of success, however short.
    frames |= {"total": 4, "lost": 4}
    assert failure_of(metrics, "desk", confirming=4) is not None


@pytest.mark.parametrize(("factor", "named"), [(1.0, False), (1.1, False), (5.0, True), (0.2, True)])
def test_poses_of_another_scale_are_named(factor, named, rng):
    poses = RECORDING.ground_truth.poses.copy()
    poses[:, :3, 3] = poses[:, :3, 3] * factor + rng.normal(scale=0.005 * factor, size=(40, 3))
    warning = scale_warning(Trajectory(RECORDING.timestamps, poses), RECORDING)
    assert (warning is not None) == named
    if named:
        scale = float(re.search(r"poses are ([0-9.]+) times as large", warning or "").group(1))
        assert scale == pytest.approx(1 / factor, rel=0.05)


def test_without_poses_and_without_motion_there_is_no_warning(rng):
    still = RECORDING.ground_truth.poses[:1].repeat(40, axis=0)
    assert scale_warning(Trajectory(RECORDING.timestamps, still), RECORDING) is None
