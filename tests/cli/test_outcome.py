"""A run that lost its way is no success; poses of another scale are named."""

import dataclasses
import re

import pytest

from sfgs_jax.cli import failure_of, scale_warning
from sfgs_jax.datasets import SyntheticRecording
from sfgs_jax.geometry import Trajectory
from sfgs_jax.slam import Run, SlamConfig, init

RECORDING = SyntheticRecording(num_frames=40, width=80, height=60)


def test_an_empty_map_and_lost_frames_are_failures():
    run = Run(init(RECORDING.camera, SlamConfig()), num_frames=40)
    assert failure_of(run, "desk").startswith("The map is empty: no Gaussian was made of 40 frames.")
    assert failure_of(run, "desk").endswith("`sfgs-jax check desk` says what is wrong with the recording.")
    mapping = dataclasses.replace(run.state.mapping, num_gaussians=100)
    run.state = dataclasses.replace(run.state, mapping=mapping, num_lost=3)
    assert failure_of(run, "desk") is None
    run.state = dataclasses.replace(run.state, num_lost=4)
    assert failure_of(run, "desk").startswith("4 of 40 frames were lost, a tenth or more.")


@pytest.mark.parametrize(("factor", "named"), [(1.0, False), (1.1, False), (5.0, True), (0.2, True)])
def test_poses_of_another_scale_are_named(factor, named, rng):
    poses = RECORDING.ground_truth.poses.copy()
    poses[:, :3, 3] = poses[:, :3, 3] * factor + rng.normal(scale=0.005 * factor, size=(40, 3))
    warning = scale_warning(Trajectory(RECORDING.timestamps, poses), RECORDING)
    assert (warning is not None) == named
    if named:
        scale = float(re.search(r"poses are ([0-9.]+) times as large", warning).group(1))
        assert scale == pytest.approx(1 / factor, rel=0.05)


def test_without_poses_and_without_motion_there_is_no_warning(rng):
    still = RECORDING.ground_truth.poses[:1].repeat(40, axis=0)
    assert scale_warning(Trajectory(RECORDING.timestamps, still), RECORDING) is None
