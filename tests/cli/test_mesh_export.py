"""`sfgs-jax export --mesh`: the surface of a run as triangles."""

import numpy as np
import pytest
import trimesh
from trimesh.visual import ColorVisuals

from sfgs_jax.cli import main
from tests.cli.walls import RED, write_run


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory):
    return write_run(tmp_path_factory.mktemp("run"))


def test_the_wall_of_a_run_becomes_a_flat_coloured_mesh(run_folder, tmp_path, capsys):
    out = tmp_path / "wall.ply"
    assert main(["export", str(run_folder), str(out), "--mesh", "--voxel", "0.05"]) == 0
    wall = trimesh.load_mesh(out)
    assert np.max(np.abs(wall.vertices[:, 2] - 2)) < 0.005
    # The view is 2.44 m wide and 1.83 m high at the wall. Cubes of voxels must be seen whole.
    assert 2.3 * 1.6 < wall.area < 2.44 * 1.83
    # Slivers have no direction worth a name.
    assert np.sum(wall.area_faces * wall.face_normals[:, 2]) == pytest.approx(-wall.area, rel=1e-3)
    assert isinstance(wall.visual, ColorVisuals)
    np.testing.assert_allclose(np.median(wall.visual.vertex_colors[:, :3], axis=0), 255 * RED, atol=3)
    printed = capsys.readouterr().out
    assert f"{out}: {len(wall.faces)} triangles from 4 images, voxels of 0.05 m in 1 MB" in printed


def test_too_little_memory_is_said(run_folder, tmp_path, caplog):
    words = ["export", str(run_folder), str(tmp_path / "wall.glb"), "--mesh", "--voxel", "0.02"]
    assert main([*words, "--mesh-memory", "1", "--mesh-part", "1"]) == 0
    assert "found no room, so the mesh has holes: take a larger --voxel or more --mesh-memory" in caplog.text


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["run", "wall.splat", "--mesh"], "A mesh is written as .ply or .glb, not as .splat"),
        (
            ["run", "wall.ply", "--mesh", "--points"],
            "A mesh is written as .ply or .glb, not as a point cloud",
        ),
        (["run/map.ply", "wall.ply", "--mesh"], "needs the trajectory of a run, and run/map.ply has none"),
        (["run", "wall.ply", "--mesh", "--voxel", "0"], "voxel must be a finite number above 0"),
    ],
)
def test_bad_input_gets_one_sentence(run_folder, tmp_path, monkeypatch, capsys, words, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run").symlink_to(run_folder)
    assert main(["export", *words]) == 2
    assert message in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
