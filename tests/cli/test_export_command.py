"""`sfgs-jax export` writes a map for other programs, and says in one sentence why it can't."""

from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from scipy.special import expit

from sfgs_jax.cli import main
from sfgs_jax.splatting import Gaussians, load_ply, load_spz, save_ply
from tests.splatting.scenes import make_scene


@pytest.fixture
def run_folder(tmp_path) -> Path:
    """A folder with a map, as a run leaves it."""
    folder = tmp_path / "run"
    folder.mkdir()
    save_ply(folder / "map.ply", make_scene(0, degree=0))
    return folder


def opacities(gaussians: Gaussians) -> np.ndarray:
    return expit(np.asarray(gaussians.opacity_logits))


def test_a_run_becomes_a_splat_file_and_its_size_is_printed(run_folder, tmp_path, capsys):
    out = tmp_path / "room.ply"
    assert main(["export", str(run_folder), str(out)]) == 0
    written, source = load_ply(out), load_ply(run_folder / "map.ply")
    np.testing.assert_array_equal(written.means, source.means)
    np.testing.assert_array_equal(written.sh, source.sh)
    size = f"{out.stat().st_size / 1e3:.1f} kB"
    assert capsys.readouterr().out == f"{out}: {len(source.means)} Gaussians, {size}\n"


def test_a_map_file_becomes_a_point_cloud_of_its_opaque_gaussians(run_folder, tmp_path):
    source, out = run_folder / "map.ply", tmp_path / "points.PLY"
    assert main(["export", str(source), str(out), "--points", "--min-opacity", "0.5"]) == 0
    kept = opacities(load_ply(source)) >= 0.5
    assert 0 < np.sum(kept) < len(kept)
    cloud = trimesh.load(out, file_type="ply")
    assert isinstance(cloud, trimesh.PointCloud)
    np.testing.assert_array_equal(cloud.vertices, np.asarray(load_ply(source).means)[kept])


def test_the_format_can_be_named_and_a_file_replaced(run_folder, tmp_path):
    out = tmp_path / "room.bin"
    out.write_text("old")
    words = ["export", str(run_folder), str(out), "--format", "ply", "--min-opacity", "0.5"]
    assert main([*words, "--overwrite"]) == 0
    assert np.min(opacities(load_ply(out))) >= 0.5
    assert [path.name for path in tmp_path.iterdir() if path.is_file()] == ["room.bin"]


def test_the_version_of_an_spz_file_is_chosen(run_folder, tmp_path):
    plain, newer = tmp_path / "room.spz", tmp_path / "newer.spz"
    assert main(["export", str(run_folder), str(plain)]) == 0
    assert main(["export", str(run_folder), str(newer), "--spz-version", "4"]) == 0
    assert plain.read_bytes()[:2] == b"\x1f\x8b"
    assert newer.read_bytes()[:4] == b"NGSP"
    np.testing.assert_array_equal(load_spz(plain).means, load_spz(newer).means)


@pytest.mark.parametrize("suffix", ["ply", "splat", "spz", "glb"])
def test_nothing_is_compiled(run_folder, tmp_path, compilations, suffix):
    assert main(["export", str(run_folder), str(tmp_path / f"room.{suffix}"), "--min-opacity", "0.1"]) == 0
    assert not compilations


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nowhere", "room.ply"], "There is no nowhere"),
        (["empty_folder", "room.ply"], "holds no map.ply"),
        (["run/notes.txt", "room.ply"], "Cannot read run/notes.txt as a PLY file"),
        (["run", "room.obj"], "names no format: use .ply"),
        (["run", "room"], "names no format"),
        (["run", "room.splat", "--points"], "written as .ply, not as .splat"),
        (["run", "room.ply", "--spz-version", "4"], "is for SPZ files, not for .ply"),
        (["run", "room.spz", "--points"], "written as .ply, not as .spz"),
        (["run", "missing/room.ply"], "There is no folder missing"),
        (["run", "empty_folder/../run/notes.txt", "--format", "ply"], "exists: give another name"),
        (["run", "empty_folder", "--format", "ply"], "is a folder"),
        (["run", "run/map.ply", "--overwrite"], "is the map itself"),
        (["nothing.ply", "room.ply"], "holds no Gaussian: there is nothing"),
        (["run", "room.ply", "--min-opacity", "1"], "no Gaussian with an opacity of 1 or more"),
        (["run", "room.ply", "--min-opacity", "1.5"], "min_opacity must be a number between 0 and 1"),
    ],
)
def test_bad_input_gets_one_sentence(run_folder, tmp_path, monkeypatch, capsys, words, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty_folder").mkdir()
    (run_folder / "notes.txt").write_text("no splats here")
    scene = make_scene(0)
    save_ply(tmp_path / "nothing.ply", replace(scene, valid=jnp.asarray(np.zeros(len(scene.means), bool))))
    before = sorted(tmp_path.rglob("*"))
    assert main(["export", *words]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.startswith("sfgs-jax: ")
    assert error.count("\n") == 1
    assert sorted(tmp_path.rglob("*")) == before
