"""`sfgs-jax render` draws a map along a path without a screen, and says in one sentence why it can't."""

import json
from pathlib import Path

import cv2
import numpy as np
import PIL.Image
import PIL.ImageSequence
import pytest

from sfgs_jax.cli import main
from sfgs_jax.geometry import read_tum
from sfgs_jax.splatting import format_background, rgb_to_sh
from tests.cli.walls import RED, way, write_run

SIZE = ("--width", "40", "--height", "30")


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory) -> Path:
    """A folder with a map and a path, as a run leaves it, whose recording is gone."""
    folder = tmp_path_factory.mktemp("run")
    return write_run(folder, source=None)


@pytest.fixture(scope="module")
def images(run_folder, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("drawn") / "images"
    words = ["render", str(run_folder), "--out", str(out), "--every", "2", "--depth", "--normals", *SIZE]
    assert main(words) == 0
    return out


def test_images_of_colour_depth_and_normals_are_numbered_files(images):
    names = [path.relative_to(images).as_posix() for path in sorted(images.rglob("*.*"))]
    kinds = [f"{kind}/{number:06d}.png" for kind in ("depth", "normals", "rgb") for number in range(2)]
    assert names == [*kinds, "trajectory.txt"]
    rgb = cv2.imread(str(images / "rgb" / "000000.png"))
    assert rgb.shape == (30, 40, 3)
    np.testing.assert_allclose(rgb[15, 20, ::-1], 255 * RED, atol=3)
    for number, metres in enumerate((2.0, 1.8)):
        depth = np.asarray(cv2.imread(str(images / "depth" / f"{number:06d}.png"), cv2.IMREAD_UNCHANGED))
        assert depth.dtype == np.uint16
        np.testing.assert_allclose(depth, 1000 * metres, atol=1)
    normals = cv2.imread(str(images / "normals" / "000001.png"))[..., ::-1]
    assert np.max(np.abs(normals.astype(int) - [128, 128, 255])) <= 1


def test_the_poses_that_were_drawn_are_kept(images):
    np.testing.assert_allclose(read_tum(images / "trajectory.txt").poses, way().poses[::2])


@pytest.mark.parametrize("suffix", [".gif", ".webp"])
def test_an_animated_image_repeats_the_same_pictures(run_folder, tmp_path, suffix):
    out = tmp_path / f"way{suffix}"
    words = ["render", str(run_folder), "--out", str(out), "--every", "2", "--fps", "10", "--quiet", *SIZE]
    assert main([*words, "--depth"]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == [out.name, f"way_depth{suffix}"]
    with PIL.Image.open(out) as still:  # the same picture twice is one that stands longer
        np.testing.assert_allclose(np.asarray(still.convert("RGB"))[15, 20], 255 * RED, atol=4)
    with PIL.Image.open(tmp_path / f"way_depth{suffix}") as animation:
        shown = []
        for picture in PIL.ImageSequence.Iterator(animation):
            shown.append(np.asarray(picture.convert("RGB"), float)[15, 20])
            assert picture.info["duration"] == 100
        assert animation.info["loop"] == 0
    assert len(shown) == 2
    assert np.abs(shown[0] - shown[1]).max() > 10


def test_a_video_shows_the_same_pictures(run_folder, images, tmp_path, capsys):
    out = tmp_path / "way.mp4"
    words = ["render", str(run_folder), "--out", str(out), "--depth", "--normals", "--quiet", *SIZE]
    assert main(words) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["way.mp4", "way_depth.mp4", "way_normals.mp4"]
    assert capsys.readouterr() == ("", "")
    video = cv2.VideoCapture(str(out))
    assert video.get(cv2.CAP_PROP_FPS) == 30
    frames = []
    while (read := video.read())[0]:
        frames.append(read[1])
    assert len(frames) == 4
    still = cv2.imread(str(images / "rgb" / "000000.png")).astype(int)
    assert np.mean(np.abs(frames[0].astype(int) - still)) < 6


def test_a_turntable_looks_at_the_middle_from_everywhere(run_folder, tmp_path):
    out = tmp_path / "turn"
    words = ["render", str(run_folder / "map.ply"), "--out", str(out), "--orbit", "4", "--radius", "3"]
    assert main([*words, "--elevation", "0", "--background", "0", "0", "1", "--normals", *SIZE]) == 0
    poses = read_tum(out / "trajectory.txt").poses
    np.testing.assert_allclose(poses[:, :3, 3] + 3 * poses[:, :3, 2], [[0, 0, 2]] * 4, atol=1e-6)
    front, side, back, _ = (cv2.imread(str(out / "rgb" / f"{n:06d}.png"))[..., ::-1] for n in range(4))
    np.testing.assert_allclose(front[15, 20], 255 * RED, atol=3)
    np.testing.assert_allclose(back[15, 20], 255 * RED, atol=3)
    # The wall is thin from the side, and the background is behind it.
    np.testing.assert_allclose(side[15, 5], [0, 0, 255])


def test_along_the_trajectory_the_runs_own_background_shows(tmp_path):
    run = write_run(tmp_path, source=None)
    blue = np.zeros((9, 3))
    blue[0] = rgb_to_sh(np.asarray([0.0, 0.0, 1.0]))
    (run / "background.txt").write_text(format_background(blue))
    corners = []
    for name, words in (("own", []), ("given", ["--background", "0", "1", "0"]), ("turn", ["--orbit", "1"])):
        out = tmp_path / name
        view = ["--out", str(out), "--quiet", "--fov", "150", *SIZE]
        assert main(["render", str(run), *view, *words]) == 0
        corners.append(cv2.imread(str(out / "rgb" / "000000.png"))[0, 0, ::-1].tolist())
    assert corners == [[0, 0, 255], [0, 255, 0], [0, 0, 0]]


def test_the_camera_is_the_recordings(tmp_path):
    write_run(tmp_path)
    out = tmp_path / "images"
    assert main(["render", str(tmp_path), "--out", str(out), "--every", "4", "--normals"]) == 0
    assert cv2.imread(str(out / "rgb" / "000000.png")).shape == (30, 40, 3)
    # A recording that is gone leaves a common camera.
    data = json.loads((tmp_path / "config.json").read_text())
    data["source"] = "/nowhere"
    (tmp_path / "config.json").write_text(json.dumps(data))
    words = ["render", str(tmp_path), "--out", str(out), "--every", "4", "--normals", "--overwrite", *SIZE]
    assert main([*words, "--fov", "60"]) == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nowhere", "--out", "images"], "There is no nowhere"),
        (["run/map.ply", "--out", "images"], "has no trajectory: give --trajectory FILE or --orbit NUMBER"),
        (["run", "--out", "images", "--trajectory", "none.txt"], "Cannot read the trajectory none.txt"),
        (["run", "--out", "images", "--orbit", "3", "--trajectory", "t.txt"], "not both"),
        (["run", "--out", "film.avi"], "A video is written as .mp4, .gif, .webp, not as .avi"),
        (["run", "--out", "missing/film.mp4"], "There is no folder missing"),
        (["run", "--out", "there.mp4"], "there.mp4 exists: give another name, or pass --overwrite"),
        (["run", "--out", "full"], "exists: give another name"),
        (["run", "--out", "images", "--background", "0", "0", "2"], "three numbers from 0 to 1"),
        (["run", "--out", "images", "--every", "0"], "every must be a whole number of at least 1"),
        (["run", "--out", "images", "--fov", "190"], "fov must be a number between 1 and 170"),
    ],
)
def test_bad_input_gets_one_sentence(run_folder, tmp_path, monkeypatch, capsys, words, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run").symlink_to(run_folder)
    (tmp_path / "there.mp4").write_text("old")
    (tmp_path / "full" / "rgb").mkdir(parents=True)
    (tmp_path / "full" / "rgb" / "000000.png").write_text("old")
    before = sorted(tmp_path.rglob("*"))
    assert main(["render", *words]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert sorted(tmp_path.rglob("*")) == before


def test_without_an_encoder_the_sentence_says_what_to_do(run_folder, tmp_path, monkeypatch, capsys):
    class NoWriter:
        fourcc = staticmethod(cv2.VideoWriter.fourcc)

        def __init__(self, *_: object) -> None:
            pass

        def isOpened(self) -> bool:
            return False

        def release(self) -> None:
            pass

    monkeypatch.setattr(cv2, "VideoWriter", NoWriter)
    words = ["render", str(run_folder), "--out", str(tmp_path / "film.mp4"), "--normals", "--quiet", *SIZE]
    assert main(words) == 2
    assert "has no encoder for .mp4: give a folder to --out" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
