"""TUM trajectories: exact to their digits, and errors that name the line."""

import jax
import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.geometry import Trajectory, format_tum, parse_tum, read_tum, se3


@pytest.fixture
def trajectory(key) -> Trajectory:
    poses = se3.to_matrices(jax.vmap(se3.exp)(2 * jax.random.normal(key, (30, 6))))
    return Trajectory(1305031229.528748 + np.arange(30) / 30, poses)


def test_round_trip(trajectory):
    back = parse_tum(format_tum(trajectory), "text")
    np.testing.assert_allclose(back.timestamps, trajectory.timestamps, atol=1e-6)
    np.testing.assert_allclose(back.poses, trajectory.poses, atol=1e-8)


def test_files_hold_xyzw():
    text = "# a comment\n\n1.5 1 2 3 0 0 1 0  # half a turn about z\n"
    np.testing.assert_allclose(
        parse_tum(text, "t").poses[0], [[-1, 0, 0, 1], [0, -1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    )


def test_an_empty_file_is_an_empty_trajectory():
    assert len(parse_tum("# nothing\n", "t")) == 0
    assert parse_tum(format_tum(parse_tum("", "t")), "t").poses.shape == (0, 4, 4)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("1 2 3", "line 2: expected"),
        ("a b c d e f g h", "line 2: expected"),
        ("1 nan 0 0 0 0 0 1", "line 2: the pose"),
        ("1 0 0 0 0 0 0 0", "no rotation"),
    ],
)
def test_bad_lines_are_named(line, words):
    with pytest.raises(InputError, match=words):
        parse_tum(f"0 0 0 0 0 0 0 1\n{line}\n", "poses.txt")


def test_a_missing_file_is_an_input_error(tmp_path):
    with pytest.raises(InputError, match="Cannot read"):
        read_tum(tmp_path / "none.txt")


def test_a_slice_keeps_times_and_poses_together(trajectory):
    part = trajectory[np.asarray([3, 7])]
    np.testing.assert_array_equal(part.positions, trajectory.positions[[3, 7]])
    np.testing.assert_array_equal(part.timestamps, trajectory.timestamps[[3, 7]])
