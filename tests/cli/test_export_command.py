"""`sfgs-jax export` writes a map for other programs, and says in one sentence why it can't."""

import os
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from scipy.special import expit

from sfgs_jax.cli import RunConfig, main, to_json
from sfgs_jax.datasets import ReaderOptions, SyntheticRecording, open_recording, write_recording
from sfgs_jax.geometry import format_tum, read_tum
from sfgs_jax.slam import SlamConfig
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


def test_a_name_that_is_no_text_can_be_shown(run_folder, tmp_path, capsys):
    out = tmp_path / os.fsdecode(b"a\xff.splat")
    assert main(["export", str(run_folder), str(out)]) == 0
    assert out.is_file()
    assert "a\\udcff.splat" in capsys.readouterr().out


def test_the_format_can_be_named_and_a_file_replaced(run_folder, tmp_path):
    out = tmp_path / "room.bin"
    out.write_text("old")
    words = ["export", str(run_folder), str(out), "--format", "ply", "--min-opacity", "0.5"]
    assert main([*words, "--overwrite"]) == 0
    assert np.min(opacities(load_ply(out))) >= 0.5
    assert [path.name for path in tmp_path.iterdir() if path.is_file()] == ["room.bin"]


def test_what_was_exported_is_exported_again(run_folder, tmp_path):
    for before, after in (("run", "a.glb"), ("a.glb", "b.spz"), ("b.spz", "c.ply")):
        assert main(["export", str(tmp_path / before), str(tmp_path / after)]) == 0
    found, source = load_ply(tmp_path / "c.ply"), load_ply(run_folder / "map.ply")
    np.testing.assert_allclose(found.means, source.means, atol=2e-4)


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
        (["run/notes.txt", "room.ply"], "run/notes.txt has none of the suffixes .ply, .splat, .spz, .glb"),
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


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    """The folder of a run of three frames, and beside it the recording."""
    root = tmp_path_factory.mktemp("posed")
    room = SyntheticRecording(num_frames=3, width=96, height=72)
    write_recording(room, root / "recording", layout="folder")
    folder = root / "run"
    folder.mkdir()
    save_ply(folder / "map.ply", make_scene(0, degree=0))
    (folder / "trajectory.txt").write_text(format_tum(room.ground_truth))
    config = RunConfig(str(root / "recording"), "folder", ReaderOptions(), SlamConfig())
    (folder / "config.json").write_text(to_json(config))
    return folder


@pytest.mark.parametrize("poses", ["nerfstudio", "colmap"])
def test_a_run_becomes_a_folder_with_poses_and_images(finished, tmp_path, capsys, poses):
    out = tmp_path / poses
    words = ["export", str(finished), str(out), "--poses", poses]
    assert main(words) == 0
    assert capsys.readouterr().out == f"{out}: 3 frames with their poses\n"
    found = open_recording(out)
    assert found.dataset == poses
    truth = read_tum(finished / "trajectory.txt")
    np.testing.assert_allclose(found.ground_truth.poses, truth.poses, atol=1e-6)
    assert main(words) == 2
    assert "not empty; give a new folder" in capsys.readouterr().err


def test_poses_become_one_file(finished, tmp_path, capsys):
    tum, kitti, rrd = (tmp_path / name for name in ("tum.txt", "kitti.txt", "run.rrd"))
    for poses, out in (("tum", tum), ("kitti", kitti)):
        assert main(["export", str(finished), str(out), "--poses", poses]) == 0
        assert capsys.readouterr().out == f"{out}: 3 poses\n"
    truth = read_tum(finished / "trajectory.txt")
    assert tum.read_text() == (finished / "trajectory.txt").read_text()
    np.testing.assert_allclose(np.loadtxt(kitti).reshape(-1, 3, 4), truth.poses[:, :3], atol=1e-8)
    moved = ["--recording", str(finished.parent / "recording")]
    assert main(["export", str(finished), str(rrd), "--poses", "rerun", *moved]) == 0
    assert rrd.stat().st_size > 1000


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--poses", "tum", "--points"], "are for maps, not for --poses"),
        (["--poses", "tum", "--min-opacity", "0.5"], "are for maps, not for --poses"),
        (["--poses", "rerun", "--recording", "nowhere"], "nowhere"),
    ],
)
def test_options_that_do_not_go_with_poses_are_refused(finished, tmp_path, capsys, words, message):
    assert main(["export", str(finished), str(tmp_path / "out"), *words]) == 2
    assert message in capsys.readouterr().err


def test_a_map_alone_has_no_poses(run_folder, tmp_path, capsys):
    assert main(["export", str(run_folder), str(tmp_path / "out.txt"), "--poses", "tum"]) == 2
    assert "has no trajectory.txt" in capsys.readouterr().err
