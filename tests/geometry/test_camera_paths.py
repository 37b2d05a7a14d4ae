"""Paths to draw from: a filter takes the shake out, an orbit looks at its middle."""

import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.geometry import Trajectory, orbit, rotation_vectors, smoothed


def turns_about_y(angles: np.ndarray) -> np.ndarray:
    c, s, zero = np.cos(angles), np.sin(angles), np.zeros_like(angles)
    rows = [[c, zero, s], [zero, zero + 1, zero], [-s, zero, c]]
    return np.moveaxis(np.asarray(rows), 2, 0)


def test_the_filter_removes_the_shake_and_keeps_the_way(rng):
    n = 200
    steps, angles = np.linspace(0, 4, n), np.linspace(0, 3 * np.pi, n)
    poses = np.tile(np.eye(4), (n, 1, 1))
    poses[:, :3, :3] = turns_about_y(angles + rng.normal(0, 0.02, n))
    poses[:, 0, 3] = steps + rng.normal(0, 0.02, n)
    found = smoothed(Trajectory(np.arange(n) / 30, poses), 6.0)
    inner = slice(25, -25)
    assert np.std(found.positions[inner, 0] - steps[inner]) < 0.006
    off = turns_about_y(-angles) @ found.poses[:, :3, :3]
    assert np.max(np.linalg.norm(rotation_vectors(off[inner]), axis=1)) < 0.02
    np.testing.assert_allclose(np.linalg.det(found.poses[:, :3, :3]), 1)
    np.testing.assert_array_equal(found.timestamps, np.arange(n) / 30)


def test_no_filter_leaves_a_trajectory_as_it_is():
    trajectory = Trajectory(np.arange(3.0), np.tile(np.eye(4), (3, 1, 1)))
    assert smoothed(trajectory, 0.0) is trajectory
    with pytest.raises(InputError, match="at most 100000"):
        smoothed(Trajectory(np.arange(2.0), np.tile(np.eye(4), (2, 1, 1))), 1e20)
    with pytest.raises(InputError, match="number from 0, not -1"):
        smoothed(trajectory, -1.0)


def test_an_orbit_looks_at_its_middle_and_stays_upright():
    target, up = np.asarray([1.0, 2, 3]), np.asarray([0.0, -2, 0])
    poses = orbit(target, up, radius=2.0, elevation=np.pi / 6, num_poses=8)
    rotations, positions = poses[:, :3, :3], poses[:, :3, 3]
    np.testing.assert_allclose(np.linalg.det(rotations), 1)
    np.testing.assert_allclose(positions + 2 * rotations[:, :, 2], np.tile(target, (8, 1)), atol=1e-12)
    # Half the radius above it; up is -y, and nothing rolls.
    np.testing.assert_allclose(positions[:, 1], 2 - 1, atol=1e-12)
    np.testing.assert_allclose(rotations[:, 1, 0], 0, atol=1e-12)
    assert np.all(rotations[:, 1, 1] > 0.8)
    # The first camera looks along z, and the distances of neighbours are those of an octagon.
    np.testing.assert_allclose(rotations[0, 0, 2], 0, atol=1e-12)
    sides = np.linalg.norm(positions - np.roll(positions, 1, axis=0), axis=1)
    np.testing.assert_allclose(sides, 2 * 2 * np.cos(np.pi / 6) * np.sin(np.pi / 8))


@pytest.mark.parametrize(
    "settings", [{"radius": 0.0}, {"radius": 1.0, "num_poses": 0}, {"radius": 1.0, "elevation": 1.6}]
)
def test_an_impossible_orbit_is_refused(settings):
    with pytest.raises(InputError, match="orbit"):
        orbit(np.zeros(3), np.asarray([0.0, 0, 1]), **settings)
