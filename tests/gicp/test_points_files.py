"""Point clouds from files, and sentences for files that hold none."""

import numpy as np
import pytest
import trimesh

from sfgs_jax.arrays import InputError
from sfgs_jax.gicp import load_points


@pytest.mark.parametrize("name", ["cloud.ply", "cloud.xyz"])
def test_points_come_back(tmp_path, rng, name):
    points = rng.normal(size=(100, 3)).astype(np.float32)
    trimesh.PointCloud(points).export(tmp_path / name)
    np.testing.assert_allclose(load_points(tmp_path / name), points, atol=1e-5)


def test_files_without_points_are_refused(tmp_path):
    with pytest.raises(InputError, match="no file"):
        load_points(tmp_path / "nothing.ply")
    (tmp_path / "broken.ply").write_bytes(b"not a cloud")
    with pytest.raises(InputError, match="Cannot read points"):
        load_points(tmp_path / "broken.ply")
    header = "ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\nproperty float z\n"
    (tmp_path / "empty.ply").write_text(header + "end_header\n")
    with pytest.raises(InputError):
        load_points(tmp_path / "empty.ply")
