"""Alignment of a depth image whose rows were exposed one after the other."""

import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import gicp
from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import KinectFaults, SyntheticRecording
from sfgs_jax.geometry import se3
from sfgs_jax.sensors import SensorTiming

FAULTS = KinectFaults(depth_delay=0.012, depth_readout=0.025)
SETTINGS = gicp.GicpConfig(levels=2, strides=(1, 1), max_iterations=(10, 10))
NUMBER = 20
INTERVAL = 1 / 30


@pytest.fixture(scope="module")
def scene():
    """The source read row by row, the target as a global shutter sees it, and the true motions."""
    faulty = SyntheticRecording(num_frames=60, width=128, height=96, faults=FAULTS)
    ideal = SyntheticRecording(num_frames=60, width=128, height=96)
    source = gicp.prepare(faulty[NUMBER].depth, faulty.camera, config=SETTINGS)
    target = gicp.prepare(ideal[NUMBER - 2].depth, ideal.camera, config=SETTINGS)
    poses = np.linalg.inv(ideal.ground_truth.poses[NUMBER - 2]) @ ideal.ground_truth.poses
    before, truth = (se3.from_matrix(poses[i]) for i in (NUMBER - 1, NUMBER))
    return source, target, before, truth


def sweep_of(before, seconds=INTERVAL, delay=FAULTS.depth_delay):
    timing = SensorTiming(delay, 0.0, FAULTS.depth_readout)
    return gicp.Sweep(before, jnp.asarray(seconds, jnp.float32), timing)


def off(found, truth):
    moved = se3.log(se3.compose(se3.inverse(truth), found.T_target_source))
    return float(jnp.linalg.norm(moved[:3]))


def test_rows_that_move_give_the_pose_at_the_time_of_the_frame(scene):
    source, target, before, truth = scene
    still = gicp.align(source, target, before, config=SETTINGS)
    swept = gicp.align(source, target, before, sweep=sweep_of(before), config=SETTINGS)
    assert off(still, truth) > 0.004
    assert off(swept, truth) < 0.35 * off(still, truth)
    assert float(swept.rmse) < float(still.rmse)


def test_a_motion_that_is_not_known_moves_nothing(scene):
    source, target, before, _ = scene
    still = gicp.align(source, target, before, config=SETTINGS)
    swept = gicp.align(source, target, before, sweep=sweep_of(before, seconds=0.0), config=SETTINGS)
    np.testing.assert_allclose(swept.T_target_source.wxyz_xyz, still.T_target_source.wxyz_xyz, atol=1e-5)


def test_points_without_rows_have_no_sweep(scene):
    _, target, before, _ = scene
    rows = np.random.default_rng(0).uniform(-1, 1, (500, 3)).astype(np.float32)
    points = gicp.prepare_points(rows, config=gicp.PointsConfig(levels=2, max_points=512, doublings=0))
    with pytest.raises(InputError, match="rows"):
        gicp.align(points, target, before, sweep=sweep_of(before), config=SETTINGS)


def swing(delay, count=12, *, before_known=True):
    """How far poses by the surface are off after some frames at rest, of which the first was 1 mm off."""
    off, before, step = 1e-3, gicp.RowMotion(jnp.zeros(6), SensorTiming(), jnp.asarray(before_known)), 1 / 30
    for _ in range(count):
        sweep = gicp.Sweep(se3.exp(along_x(off)), jnp.asarray(step), SensorTiming(delay), before)
        # The pose at which the surface, moved back by what it seems to have moved, lies where it is.
        at_rest, at_one = (delay * float(sweep.at(se3.exp(along_x(x))).twist[0]) for x in (0.0, 1e-3))
        found = -at_rest / (1 + (at_one - at_rest) / 1e-3)
        twist = along_x((found - off) / step)
        off, before = found, gicp.RowMotion(twist, SensorTiming(), jnp.asarray(before_known))
    return abs(off)


def along_x(metres):
    return jnp.zeros(6).at[0].set(metres)


@pytest.mark.parametrize("delay", [-0.016, -0.015, -0.01, 0.0, 0.015])
def test_an_error_of_a_pose_dies_out_whichever_of_depth_and_colour_comes_first(delay):
    assert swing(delay) < 1e-5


def test_without_the_motion_before_it_would_swing():
    assert swing(-0.015, before_known=False) > 5e-5


def test_depth_that_is_hardly_early_takes_the_motion_to_the_pose_sought(scene):
    _, _, before, truth = scene
    other = gicp.RowMotion(jnp.ones(6), SensorTiming(), jnp.asarray(True))
    for delay, same in ((0.012, True), (-0.01, True), (-0.015, False)):
        alone = sweep_of(before, delay=delay)
        both = gicp.Sweep(before, alone.seconds, alone.timing, other)
        assert np.array_equal(both.at(truth).twist, alone.at(truth).twist) == same
