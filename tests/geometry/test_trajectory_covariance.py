"""Covariances of a trajectory as a file."""

import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.geometry import format_covariances, read_covariances


def test_covariances_come_back_from_their_file(tmp_path, rng):
    roots = 1e-3 * rng.normal(size=(5, 6, 6))
    times, covariances = 1.3e9 + np.arange(5) / 30, roots @ np.swapaxes(roots, 1, 2)
    path = tmp_path / "trajectory_covariance.txt"
    path.write_text(format_covariances(times, covariances))
    found = read_covariances(path)
    np.testing.assert_allclose(found[0], times, atol=1e-6)
    np.testing.assert_allclose(found[1], covariances, rtol=1e-5)
    assert len(path.read_text().splitlines()[1].split()) == 22


def test_no_frames_are_no_covariances(tmp_path):
    path = tmp_path / "none.txt"
    path.write_text(format_covariances(np.zeros(0), np.zeros((0, 6, 6))))
    times, covariances = read_covariances(path)
    assert times.shape == (0,)
    assert covariances.shape == (0, 6, 6)


@pytest.mark.parametrize("text", ["1 2 3\n", "1 " + "x " * 21, "1 " + "nan " * 21, None])
def test_what_is_no_such_file_is_refused(tmp_path, text):
    path = tmp_path / "bad.txt"
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError, match="covariances"):
        read_covariances(path)
