"""Matching of time stamps, and poses between them."""

import jax.numpy as jnp
import numpy as np

from sfgs_jax.datasets import associate, poses_at
from sfgs_jax.geometry import Trajectory, se3


def test_pairs_are_nearest_one_to_one_and_within_the_limit():
    a = np.array([0.00, 0.10, 0.20, 0.30])
    b = np.array([0.011, 0.095, 0.104, 0.25, 0.305])
    assert associate(a, b, 0.02).tolist() == [[0, 0], [1, 2], [3, 4]]


def test_a_stamp_wanted_twice_goes_to_the_closer_one():
    a = np.array([1.000, 1.012])
    b = np.array([1.010])
    assert associate(a, b, 0.02).tolist() == [[1, 0]]
    # The other one takes its second nearest where there is one.
    assert associate(a, np.array([0.985, 1.010]), 0.02).tolist() == [[0, 0], [1, 1]]


def test_nothing_to_match():
    assert associate(np.zeros(0), np.ones(3), 0.02).shape == (0, 2)
    assert associate(np.ones(3), np.zeros(0), 0.02).shape == (0, 2)
    assert associate(np.zeros(2), np.full(2, 5.0), 0.02).shape == (0, 2)


def _screw(times: np.ndarray) -> np.ndarray:
    """Poses of a constant turn with a straight motion, which interpolation gives back exactly."""
    poses = []
    for t in times.tolist():
        pose = np.asarray(se3.matrix(se3.exp(jnp.asarray([0, 0, 0, 0.8 * t, -0.5 * t, 1.1 * t]))), np.float64)
        pose[:3, 3] = [t, 2 * t, -t]
        poses.append(pose)
    return np.stack(poses)


def test_poses_are_interpolated():
    times = np.arange(10) * 0.01
    wanted = np.array([0.0, 0.014, 0.05, 0.0888])
    got, known = poses_at(Trajectory(times, _screw(times)), wanted, 0.02)
    assert known.tolist() == [0, 1, 2, 3]
    assert got.timestamps.tolist() == wanted.tolist()
    np.testing.assert_allclose(got.poses, _screw(wanted), atol=2e-6)


def test_over_a_gap_the_near_pose_is_taken_or_none():
    times = np.array([0.0, 1.0])
    trajectory = Trajectory(times, _screw(times))
    got, known = poses_at(trajectory, np.array([-0.01, 0.015, 0.5, 0.985, 1.3]), 0.02)
    assert known.tolist() == [0, 1, 3]
    np.testing.assert_allclose(got.poses, _screw(np.array([0.0, 0.0, 1.0])), atol=1e-6)


def test_single_pose():
    got, known = poses_at(Trajectory(np.ones(1), np.eye(4)[None]), np.array([0.5, 1.01]), 0.02)
    assert known.tolist() == [1]
    np.testing.assert_allclose(got.poses[0], np.eye(4), atol=1e-12)
