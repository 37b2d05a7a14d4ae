"""Pose files, also with poses that can't be used."""

import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets.files import (
    ground_truth_by_frame,
    ground_truth_by_time,
    read_matrix_file,
    read_matrix_rows,
    read_tum_poses,
)

IDENTITY_ROW = "1 0 0 0.5 0 1 0 0 0 0 1 0"


def test_rows_of_twelve_or_sixteen_numbers(tmp_path):
    path = tmp_path / "poses.txt"
    path.write_text(f"# comment\n{IDENTITY_ROW}\n\n{IDENTITY_ROW.replace(' ', ',')},0,0,0,1\n")
    poses = read_matrix_rows(path)
    assert poses.shape == (2, 4, 4)
    np.testing.assert_allclose(poses[0], poses[1])
    np.testing.assert_allclose(poses[0, :3, 3], [0.5, 0, 0])


def test_poses_that_are_no_rigid_motion_are_nan(tmp_path):
    path = tmp_path / "poses.txt"
    mirrored, scaled = "-1 0 0 0 0 1 0 0 0 0 1 0", "2 0 0 0 0 2 0 0 0 0 2 0"
    path.write_text(
        "\n".join([IDENTITY_ROW, " ".join(["-inf"] * 16), mirrored, scaled, " ".join(["nan"] * 12)])
    )
    known = np.isfinite(read_matrix_rows(path)).all(axis=(1, 2))
    assert known.tolist() == [True, False, False, False, False]


def test_rotations_of_few_digits_become_orthonormal(tmp_path):
    path = tmp_path / "pose.txt"
    path.write_text("0.866 -0.5 0 1\n0.5 0.866 0 2\n0 0 1 3\n0 0 0 1\n")
    rotation = read_matrix_file(path)[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(rotation[0, 0], np.sqrt(0.75), atol=1e-4)


@pytest.mark.parametrize("text", ["1 2 3\n", "a b c\n", IDENTITY_ROW + " 7\n"])
def test_other_lines_are_refused(tmp_path, text):
    (tmp_path / "poses.txt").write_text(text)
    with pytest.raises(InputError, match=r"poses\.txt"):
        read_matrix_rows(tmp_path / "poses.txt")
    with pytest.raises(InputError, match=r"poses\.txt"):
        read_matrix_file(tmp_path / "poses.txt")


def test_tum_poses_by_time_without_broken_ones(tmp_path):
    path = tmp_path / "groundtruth.txt"
    path.write_text("# t\n2.0 2 0 0 0 0 0 1\n1.0 1 0 0 0 0 0 1\n1.5 nan 0 0 0 0 0 1\n1.7 0 0 0 0 0 0 0\n")
    trajectory, broken = read_tum_poses(path)
    assert trajectory.timestamps.tolist() == [1.0, 2.0]
    assert broken == 2
    path.write_text("1.0 nan 0 0 0 0 0 1\n1.0 2 3\n")
    with pytest.raises(InputError, match="line 2"):
        read_tum_poses(path)


def test_notes_say_what_is_missing(tmp_path):
    poses = [np.eye(4), None, np.full((4, 4), np.nan), np.eye(4)]
    trajectory, notes = ground_truth_by_frame(poses, np.arange(4.0))
    assert trajectory is not None
    assert trajectory.timestamps.tolist() == [0.0, 3.0]
    assert notes == [
        "1 ground-truth pose is not finite and ignored.",
        "1 of 4 frames have no ground-truth pose.",
    ]
    assert ground_truth_by_frame([None, None], np.arange(2.0)) == (None, [])
    assert ground_truth_by_frame([np.full((4, 4), np.nan)], np.arange(1.0))[0] is None
    assert ground_truth_by_time(tmp_path / "none.txt", np.arange(2.0), 0.02) == (None, [])
    (tmp_path / "empty.txt").write_text("# nothing\n")
    assert "no poses" in ground_truth_by_time(tmp_path / "empty.txt", np.arange(2.0), 0.02)[1][0]
