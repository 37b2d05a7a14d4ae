"""Point clouds from files, and sentences for files that hold none."""

import json

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


@pytest.mark.parametrize("name", ["box.obj", "box.stl", "box.off", "box.ply", "box.glb", "box.gltf"])
def test_corners_of_meshes_come_back(tmp_path, name):
    box = trimesh.creation.box((1, 2, 3))
    written = box.export(file_type=name.partition(".")[2])
    # A glTF has its data in files beside it.
    for part, content in (written if isinstance(written, dict) else {name: written}).items():
        data = content.encode() if isinstance(content, str) else content
        (tmp_path / (name if part.endswith("gltf") else part)).write_bytes(data)
    points = load_points(tmp_path / name)
    np.testing.assert_allclose(np.unique(points, axis=0), np.unique(box.vertices, axis=0), atol=1e-6)


def test_numbers_without_data_take_no_memory(tmp_path):
    """A glTF of 700 bytes that stands for fifty million points."""
    accessor = {"componentType": 5126, "count": 49_999_998, "type": "VEC3"}
    description = {
        "asset": {"version": "2.0"},
        "accessors": [accessor],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
    }
    (tmp_path / "bomb.gltf").write_text(json.dumps(description))
    with pytest.raises(InputError, match="numbers without data"):
        load_points(tmp_path / "bomb.gltf")


def test_archives_and_files_elsewhere_are_left_alone(tmp_path):
    (tmp_path / "cloud.zip").write_bytes(b"PK")
    with pytest.raises(InputError, match="unpack it first"):
        load_points(tmp_path / "cloud.zip")
    (tmp_path / "outside.bin").write_bytes(bytes(36))
    (tmp_path / "inside").mkdir()
    description = {"asset": {"version": "2.0"}, "buffers": [{"uri": "../outside.bin", "byteLength": 36}]}
    (tmp_path / "inside" / "a.gltf").write_text(json.dumps(description))
    with pytest.raises(InputError, match="Cannot read points"):
        load_points(tmp_path / "inside" / "a.gltf")


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
