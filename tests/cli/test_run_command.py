"""`sfgs-jax run` as a user meets it: results, refusals, interruptions; nothing computed is lost."""

import json
import os
import re
import shutil
import signal

import cv2
import numpy as np
import pytest

import sfgs_jax.cli.run as run_module
from sfgs_jax.cli.main import main
from sfgs_jax.datasets import SyntheticRecording, write_recording
from sfgs_jax.geometry import read_tum
from sfgs_jax.slam import OUTPUT_FILES, outputs
from sfgs_jax.splatting import load_ply

SMALL = [
    "--mapping.capacity",
    "8192",
    "--mapping.pair-capacity",
    "32768",
    "--mapping.final-steps",
    "3",
    "--quiet",
]
NUM_FRAMES = 12


@pytest.fixture(scope="module")
def recording_folder(tmp_path_factory):
    """A plain folder with a small recording."""
    folder = tmp_path_factory.mktemp("recordings") / "room"
    write_recording(SyntheticRecording(num_frames=NUM_FRAMES, width=96, height=72), folder, layout="folder")
    return folder


@pytest.fixture(autouse=True)
def no_compilation_cache(monkeypatch):
    """Tests leave the user's cache alone."""
    monkeypatch.setattr(run_module, "enable_compilation_cache", lambda: None)


@pytest.fixture
def copy(recording_folder, tmp_path):
    """A copy of the recording that a test may damage."""
    return shutil.copytree(recording_folder, tmp_path / "copy")


def run(source, out, *options):
    return main(["run", str(source), "--out", str(out), *SMALL, *options])


@pytest.fixture(scope="module")
def finished(recording_folder, tmp_path_factory):
    """The output folder of a finished run."""
    out = tmp_path_factory.mktemp("runs") / "room"
    assert run(recording_folder, out) == 0
    return out


def test_writes_every_output(finished):
    assert sorted(path.name for path in finished.iterdir()) == sorted(OUTPUT_FILES)
    trajectory = read_tum(finished / "trajectory.txt")
    assert len(trajectory) == NUM_FRAMES
    keyframes = read_tum(finished / "keyframes.txt")
    assert set(keyframes.timestamps) <= set(trajectory.timestamps)
    metrics = json.loads((finished / "metrics.json").read_text())
    assert metrics["frames"]["total"] == metrics["frames"]["tracked"] == NUM_FRAMES
    assert int(np.sum(load_ply(finished / "map.ply").valid)) == metrics["map"]["gaussians"] > 500
    assert metrics["ate"]["rmse_m"] < 0.03
    assert metrics["psnr"]["all"] > 18
    assert {"tracking", "graph", "view", "mapping"} <= set(metrics["stages"])
    # All of the run has the compilation and the refinement besides.
    assert metrics["fps"]["frames"] > metrics["fps"]["overall"] > 0
    assert metrics["memory"]["peak_mb"] > 50


def test_the_same_run_gives_the_same_files(finished, recording_folder, tmp_path):
    out = tmp_path / "again"
    assert run(recording_folder, out, "--config", str(finished / "config.json"), "--no-evaluate") == 0
    for name in ("trajectory.txt", "keyframes.txt", "map.ply"):
        assert (out / name).read_bytes() == (finished / name).read_bytes(), name


def test_eval_computes_the_metrics_again(finished, capsys):
    before = json.loads((finished / "metrics.json").read_text())
    (finished / "report.html").unlink()
    assert main(["eval", str(finished)]) == 0
    after = json.loads((finished / "metrics.json").read_text())
    assert after["ate"] == before["ate"]
    assert after["psnr"]["all"] == pytest.approx(before["psnr"]["all"], abs=1e-3)
    assert (finished / "report.html").exists()
    assert json.loads(capsys.readouterr().out)["frames"] == before["frames"]


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda folder: shutil.rmtree(folder), "There is no"),
        (lambda folder: shutil.rmtree(folder / "rgb"), "layout|rgb"),
        (lambda folder: [path.unlink() for path in (folder / "rgb").iterdir()], "image"),
        (lambda folder: (folder / "camera.json").unlink(), "camera.json"),
    ],
    ids=["missing path", "unknown layout", "no images", "no intrinsics"],
)
def test_unusable_recordings_get_one_sentence(copy, tmp_path, capsys, damage, words):
    damage(copy)
    assert run(copy, tmp_path / "out") == 2
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1
    assert error.startswith("sfgs-jax: ")
    assert re.search(words, error), error


def test_a_folder_with_something_in_it_is_left_alone(recording_folder, tmp_path, capsys):
    (tmp_path / "thesis.txt").write_text("mine")
    assert run(recording_folder, tmp_path) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert os.listdir(tmp_path) == ["thesis.txt"]


def test_overwriting_replaces_results_only(recording_folder, tmp_path):
    (tmp_path / "thesis.txt").write_text("mine")
    (tmp_path / "map.ply").write_text("old")
    assert run(recording_folder, tmp_path, "--overwrite", "--no-evaluate", "--reader.end", "2") == 0
    assert (tmp_path / "thesis.txt").read_text() == "mine"
    assert (tmp_path / "map.ply").read_bytes().startswith(b"ply")


def test_an_output_path_that_is_a_file_is_refused(recording_folder, tmp_path, capsys):
    (tmp_path / "out").write_text("")
    assert run(recording_folder, tmp_path / "out") == 2
    assert "cannot be written" in capsys.readouterr().err


def test_a_truncated_image_in_mid_run_is_skipped_and_counted(copy, tmp_path):
    image = sorted((copy / "depth").iterdir())[4]
    image.write_bytes(image.read_bytes()[:200])
    assert run(copy, tmp_path / "out", "--no-evaluate") == 0
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["frames"]["skipped"] == 1
    assert metrics["frames"]["tracked"] == NUM_FRAMES - 1
    assert "frame 4 skipped" in (tmp_path / "out" / "run.log").read_text()


def test_a_frame_without_depth_is_not_skipped(copy, tmp_path):
    image = sorted((copy / "depth").iterdir())[5]
    cv2.imwrite(str(image), np.zeros((72, 96), np.uint16))
    assert run(copy, tmp_path / "out", "--no-evaluate") == 0
    frames = json.loads((tmp_path / "out" / "metrics.json").read_text())["frames"]
    assert frames["skipped"] == 0
    assert frames["tracked"] + frames["lost"] == NUM_FRAMES
    assert frames["lost"] <= 1


def test_too_many_bad_images_stop_the_run_but_keep_what_there_is(copy, tmp_path, capsys):
    for image in sorted((copy / "rgb").iterdir())[5:]:
        image.write_bytes(b"\x89PNG")
    assert run(copy, tmp_path / "out", "--no-evaluate") == 1
    assert "max_skipped_fraction" in capsys.readouterr().err
    assert len(read_tum(tmp_path / "out" / "trajectory.txt")) == 5
    assert np.sum(load_ply(tmp_path / "out" / "map.ply").valid) > 500


def test_non_finite_ground_truth_is_ignored_with_a_warning(copy, tmp_path):
    lines = (copy / "poses.txt").read_text().splitlines()
    place = next(i for i, line in enumerate(lines) if not line.startswith("#"))
    lines[place + 1] = " ".join(["nan"] * len(lines[place + 1].split()))
    if len(lines[place].split()) == 8:
        lines[place + 1] = lines[place + 1].replace("nan", lines[place].split()[0], 1)
    (copy / "poses.txt").write_text("\n".join(lines) + "\n")
    assert run(copy, tmp_path / "out") == 0
    assert json.loads((tmp_path / "out" / "metrics.json").read_text())["ate"]["rmse_m"] < 0.03
    assert "WARNING" in (tmp_path / "out" / "run.log").read_text()


def test_without_ground_truth_it_runs_and_says_what_it_cannot_give(copy, tmp_path):
    (copy / "poses.txt").unlink()
    assert run(copy, tmp_path / "out") == 0
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert "ate" not in metrics
    assert "ground truth" in metrics["unavailable"]["ate"]
    assert metrics["psnr"]["all"] > 18


@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM])
def test_interruption_saves_what_there_is_and_exits_130(recording_folder, tmp_path, monkeypatch, signum):
    real = run_module.prefetch

    def interrupted(recording, **options):
        for index, frame in real(recording, **options):
            if index == 6:
                os.kill(os.getpid(), signum)
            yield index, frame

    monkeypatch.setattr(run_module, "prefetch", interrupted)
    # A shell's background jobs are born deaf to Ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    assert run(recording_folder, tmp_path / "out") == 130
    assert len(read_tum(tmp_path / "out" / "trajectory.txt")) == 6
    assert np.sum(load_ply(tmp_path / "out" / "map.ply").valid) > 500
    assert json.loads((tmp_path / "out" / "metrics.json").read_text())["frames"]["interrupted"] is True


def test_a_run_that_was_stopped_goes_on_to_the_same_end(
    finished, recording_folder, tmp_path, monkeypatch, capsys
):
    real, out = run_module.prefetch, tmp_path / "out"

    def interrupted(recording, **options):
        for index, frame in real(recording, **options):
            if index == 6:
                raise KeyboardInterrupt
            yield index, frame

    with monkeypatch.context() as patch:
        patch.setattr(run_module, "prefetch", interrupted)
        assert run(recording_folder, out) == 130
    assert "--resume" in capsys.readouterr().err
    assert run(recording_folder, out, "--resume", "--mapping.view-interval", "3") == 2
    assert "other settings" in capsys.readouterr().err
    assert run(recording_folder, out, "--resume") == 0
    for name in ("trajectory.txt", "keyframes.txt", "map.ply"):
        assert (out / name).read_bytes() == (finished / name).read_bytes(), name
    assert sorted(path.name for path in out.iterdir()) == sorted(OUTPUT_FILES)
    assert run(recording_folder, out, "--resume") == 2
    assert "no run that could be resumed" in capsys.readouterr().err


def test_ablations_reach_the_settings(recording_folder, tmp_path, capsys):
    out = tmp_path / "out"
    switches = ["--no-factor-graph", "--no-loops", "--features", "none"]
    assert run(recording_folder, out, *switches, "--no-evaluate", "--reader.end", "3") == 0
    slam = json.loads((out / "config.json").read_text())["slam"]
    assert slam["tracking"]["features"]["kind"] == "none"
    assert slam["graph"]["enabled"] is slam["graph"]["loops"] is False
    assert run(recording_folder, tmp_path / "b", "--features", "none", "--no-gicp") == 2
    assert "nothing is left" in capsys.readouterr().err


def test_a_full_disk_costs_no_results(recording_folder, tmp_path, monkeypatch, capsys):
    out, refuge = tmp_path / "out", tmp_path / "refuge"
    refuge.mkdir()
    real = outputs.write_atomically

    def full(path, content):
        if path.parent == out:
            raise OSError(28, "No space left on device", str(path))
        real(path, content)

    monkeypatch.setattr(outputs, "write_atomically", full)
    monkeypatch.setattr(run_module.tempfile, "mkdtemp", lambda prefix: str(refuge))
    assert run(recording_folder, out, "--no-evaluate") == 1
    assert str(refuge) in capsys.readouterr().err
    assert len(read_tum(refuge / "trajectory.txt")) == NUM_FRAMES
    assert np.sum(load_ply(refuge / "map.ply").valid) > 500


@pytest.mark.parametrize("arguments", [["fly"], ["run"], ["run", "synthetic", "--dataset", "kitti"]])
def test_wrong_commands_are_refused(arguments, capsys):
    try:
        status = main(arguments)
    except SystemExit as exit_:
        status = exit_.code
    assert status == 2
    assert capsys.readouterr().err


def test_help_names_the_commands(capsys):
    assert main(["--help"]) == 0
    shown = capsys.readouterr().out
    assert all(name in shown for name in ("run", "eval", "view", "doctor"))
