"""`sfgs-jax run` as a user meets it: results, refusals, interruptions; nothing computed is lost."""

import errno
import inspect
import json
import os
import re
import shutil
import signal
import tempfile
import time
from contextlib import ExitStack, suppress
from functools import partial

import cv2
import numpy as np
import pytest

from experiments.crash_faults import ReadOnly
from experiments.crash_outputs import failing_outputs, other_files, stopped_run
from sfgs_jax import slam
from sfgs_jax.cli import COMMANDS, Command, RunObserver, main, run_command, summary
from sfgs_jax.datasets import LAYOUTS, SyntheticRecording, open_recording, prefetch, write_recording
from sfgs_jax.geometry import read_covariances, read_tum
from sfgs_jax.slam import GROUND_TRUTH_FILE, OUTPUT_FILES, STORAGE, locked_folder
from sfgs_jax.slam.run import saved_facts
from sfgs_jax.splatting import load_ply
from tests.viewer.browser import OpenPage

pytestmark = pytest.mark.usefixtures("own_compilation_cache")
SMALL = [
    "--mapping.capacity",
    "8192",
    "--mapping.pair-capacity",
    "32768",
    "--mapping.final-steps",
    "3",
    # One level registers so small an image as well, and compiles sooner.
    "--tracking.gicp.levels",
    "1",
    "--quiet",
]
NUM_FRAMES = 12
# Nothing is estimated of a camera in a folder, unless it is asked for.
WRITTEN = {*OUTPUT_FILES, GROUND_TRUTH_FILE} - {"sensors.json"}


@pytest.fixture(scope="module")
def recording_folder(tmp_path_factory):
    """A plain folder with a small recording."""
    folder = tmp_path_factory.mktemp("recordings") / "room"
    write_recording(SyntheticRecording(num_frames=NUM_FRAMES, width=96, height=72), folder, layout="folder")
    return folder


@pytest.fixture
def copy(recording_folder, tmp_path):
    """A copy of the recording that a test may damage."""
    return shutil.copytree(recording_folder, tmp_path / "copy")


def run(source, out, *options, frames=prefetch):
    """`sfgs-jax run`, with another source of frames if one is given."""
    commands = {**COMMANDS, "run": Command(partial(run_command, frames=frames), "")}
    return main(["run", str(source), "--out", str(out), *SMALL, *options], commands=commands)


def before_frame(number, action):
    """A source of frames that does something before it gives one of them."""

    def frames(recording, *, first):
        for index, frame in prefetch(recording, first=first):
            if index == number:
                action()
            yield index, frame

    return frames


def interrupt():
    raise KeyboardInterrupt


@pytest.fixture
def no_warm_up(monkeypatch):
    """Programs are compiled when they are called first; here they are compiled already."""
    monkeypatch.setattr(inspect.getmodule(slam.run), "warm_up", lambda camera, config: None)


@pytest.fixture(scope="module")
def finished(recording_folder, tmp_path_factory):
    """The output folder of a finished run."""
    out = tmp_path_factory.mktemp("runs") / "room"
    assert run(recording_folder, out) == 0
    return out


def test_writes_every_output(finished, recording_folder):
    assert {path.name for path in finished.iterdir()} == WRITTEN
    trajectory = read_tum(finished / "trajectory.txt")
    assert len(trajectory) == NUM_FRAMES
    timestamps, covariances = read_covariances(finished / "trajectory_covariance.txt")
    np.testing.assert_array_equal(timestamps, trajectory.timestamps)
    assert np.linalg.eigvalsh(covariances[1:]).min() > 0
    keyframes = read_tum(finished / "keyframes.txt")
    assert set(keyframes.timestamps) <= set(trajectory.timestamps)
    metrics = json.loads((finished / "metrics.json").read_text())
    assert metrics["frames"]["total"] == metrics["frames"]["tracked"] == NUM_FRAMES
    assert int(np.sum(load_ply(finished / "map.ply").valid)) == metrics["map"]["gaussians"] > 500
    assert metrics["ate"]["rmse_m"] < 0.03
    # evo_ape tum groundtruth.txt trajectory.txt finds both.
    np.testing.assert_array_equal(read_tum(finished / GROUND_TRUTH_FILE).timestamps, trajectory.timestamps)
    assert metrics["nees"]["within_3_sigma"] == 1
    assert metrics["psnr"]["all"] > 18
    assert {"tracking", "graph", "view", "mapping"} <= set(metrics["stages"])
    # All of the run has the compilation and the refinement besides.
    assert metrics["fps"]["frames"] > metrics["fps"]["overall"] > 0
    assert metrics["memory"]["peak_mb"] > 50
    camera = open_recording(recording_folder).camera
    found = metrics["camera"]
    assert (found["width"], found["height"]) == (camera.width, camera.height)
    np.testing.assert_allclose(found["fx"], camera.fx, rtol=1e-6)


def test_the_same_run_gives_the_same_files_while_it_is_watched(
    finished, recording_folder, tmp_path, browser, free_port, capsys
):
    pages = []

    def watch():
        pages.append(OpenPage(browser, free_port))
        pages[0].wait_for_text("Frame 1 of")

    def look_away():
        # The page and its images have come, and its server has no errors to tell.
        pages[0].wait_for_text("Gaussians")
        assert pages[0].errors == []
        pages[0].close()

    def frames(recording, *, first):
        for index, frame in prefetch(recording, first=first):
            for number, action in ((1, watch), (NUM_FRAMES - 1, look_away)):
                if index == number:
                    action()
            yield index, frame

    out, port = tmp_path / "again", ["--view-port", str(free_port)]
    config = ["--config", str(finished / "config.json")]
    assert run(recording_folder, out, *config, "--no-evaluate", "--view", *port, frames=frames) == 0
    assert f"http://127.0.0.1:{free_port}" in capsys.readouterr().out
    for name in ("trajectory.txt", "keyframes.txt", "map.ply"):
        assert (out / name).read_bytes() == (finished / name).read_bytes(), name


def test_eval_computes_the_metrics_again(finished, capsys):
    before = json.loads((finished / "metrics.json").read_text())
    (finished / "report.html").unlink()
    assert main(["eval", str(finished)]) == 0
    after = json.loads((finished / "metrics.json").read_text())
    assert after["ate"] == before["ate"]
    assert after["psnr"]["all"] == pytest.approx(before["psnr"]["all"], abs=1e-3)
    assert after["frames"] == before["frames"]
    assert (finished / "report.html").exists()
    shown = capsys.readouterr().out.splitlines()
    assert f"{NUM_FRAMES} of {NUM_FRAMES} frames tracked" in shown[0]
    assert f"ATE RMSE {100 * after['ate']['rmse_m']:.2f} cm" in shown
    assert f"report: {finished / 'report.html'}" in shown
    assert len(shown) < 12


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


@pytest.mark.usefixtures("no_warm_up")
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


@pytest.mark.usefixtures("no_warm_up")
def test_a_truncated_image_in_mid_run_is_skipped_and_counted(copy, tmp_path):
    image = sorted((copy / "depth").iterdir())[4]
    image.write_bytes(image.read_bytes()[:200])
    assert run(copy, tmp_path / "out", "--no-evaluate") == 0
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["frames"]["skipped"] == 1
    assert metrics["frames"]["tracked"] == NUM_FRAMES - 1
    assert "frame 4 skipped" in (tmp_path / "out" / "run.log").read_text()


@pytest.mark.usefixtures("no_warm_up")
def test_a_frame_without_depth_is_not_skipped(copy, tmp_path):
    image = sorted((copy / "depth").iterdir())[5]
    cv2.imwrite(str(image), np.zeros((72, 96), np.uint16))
    assert run(copy, tmp_path / "out", "--no-evaluate") == 0
    frames = json.loads((tmp_path / "out" / "metrics.json").read_text())["frames"]
    assert frames["skipped"] == 0
    assert frames["tracked"] + frames["lost"] == NUM_FRAMES
    assert frames["lost"] <= 1


@pytest.mark.usefixtures("no_warm_up")
def test_too_many_bad_images_stop_the_run_but_keep_what_there_is(copy, tmp_path, capsys):
    for image in sorted((copy / "rgb").iterdir())[5:]:
        image.write_bytes(b"\x89PNG")
    assert run(copy, tmp_path / "out", "--no-evaluate") == 1
    assert "max_skipped_fraction" in capsys.readouterr().err
    assert len(read_tum(tmp_path / "out" / "trajectory.txt")) == 5
    assert np.sum(load_ply(tmp_path / "out" / "map.ply").valid) > 500


@pytest.mark.usefixtures("no_warm_up")
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


@pytest.mark.usefixtures("no_warm_up")
def test_without_ground_truth_it_runs_and_says_what_it_cannot_give(copy, tmp_path):
    (copy / "poses.txt").unlink()
    assert run(copy, tmp_path / "out") == 0
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert "ate" not in metrics
    assert "ground truth" in metrics["unavailable"]["ate"]
    assert metrics["psnr"]["all"] > 18


@pytest.mark.usefixtures("no_warm_up")
@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM])
def test_interruption_saves_what_there_is_and_exits_130(recording_folder, tmp_path, signum):
    # A shell's background jobs are born deaf to Ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    frames = before_frame(6, lambda: os.kill(os.getpid(), signum))
    assert run(recording_folder, tmp_path / "out", frames=frames) == 130
    assert len(read_tum(tmp_path / "out" / "trajectory.txt")) == 6
    assert np.sum(load_ply(tmp_path / "out" / "map.ply").valid) > 500
    assert json.loads((tmp_path / "out" / "metrics.json").read_text())["frames"]["interrupted"] is True


@pytest.mark.usefixtures("no_warm_up")
@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM])
def test_an_interruption_that_compiled_code_forgets_ends_the_run_after_its_frame(
    recording_folder, tmp_path, signum
):
    signal.signal(signal.SIGINT, signal.default_int_handler)

    def forget():
        with suppress(KeyboardInterrupt):
            os.kill(os.getpid(), signum)
            time.sleep(10)

    assert run(recording_folder, tmp_path / "out", frames=before_frame(6, forget)) == 130
    assert len(read_tum(tmp_path / "out" / "trajectory.txt")) == 7


@pytest.mark.usefixtures("no_warm_up")
def test_a_run_that_was_stopped_goes_on_to_the_same_end(finished, recording_folder, tmp_path, capsys):
    out = tmp_path / "out"
    assert run(recording_folder, out, frames=before_frame(6, interrupt)) == 130
    assert "--resume" in capsys.readouterr().err
    assert run(recording_folder, out, "--resume", "--mapping.view-interval", "3") == 2
    assert "other settings" in capsys.readouterr().err
    assert run(recording_folder, out, "--resume") == 0
    for name in ("trajectory.txt", "keyframes.txt", "map.ply"):
        assert (out / name).read_bytes() == (finished / name).read_bytes(), name
    assert {path.name for path in out.iterdir()} == WRITTEN
    assert run(recording_folder, out, "--resume") == 2
    assert "no run that could be resumed" in capsys.readouterr().err


class Killed(BaseException):
    """Stands for a kill: nobody catches it."""


def killed_at_step(monkeypatch, number):
    """The process is gone right after a step of the refinement."""
    told = RunObserver.__call__

    def observe(self, progress):
        told(self, progress)
        if (progress.stage, progress.done) == ("refinement", number):
            raise Killed

    monkeypatch.setattr(RunObserver, "__call__", observe)


@pytest.mark.usefixtures("no_warm_up")
def test_a_run_that_was_killed_in_its_refinement_goes_on_there(
    finished, recording_folder, tmp_path, monkeypatch
):
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        killed_at_step(patch, 2)
        with pytest.raises(Killed):
            run(recording_folder, out, "--checkpoint-interval", "2")
    assert saved_facts(out / STORAGE)["num_refined"] == 2
    assert run(recording_folder, out, "--resume") == 0
    for name in ("trajectory.txt", "keyframes.txt", "map.ply"):
        assert (out / name).read_bytes() == (finished / name).read_bytes(), name


def test_a_second_run_in_the_same_folder_is_refused(recording_folder, tmp_path, capsys):
    out = tmp_path / "out"
    with locked_folder(out):
        assert run(recording_folder, out, "--overwrite") == 2
        assert "Another run writes to" in capsys.readouterr().err
        assert run(recording_folder, out, "--resume") == 2
        assert "Another run writes to" in capsys.readouterr().err
    assert list(out.iterdir()) == []
    with locked_folder(tmp_path / "none", make=False):
        assert not (tmp_path / "none").exists()


@pytest.mark.usefixtures("no_warm_up")
def test_resume_is_not_offered_where_no_checkpoint_could_be_written(
    recording_folder, tmp_path, monkeypatch, capsys
):
    out = tmp_path / "out"

    def fill_the_disk():
        def refuse(*arguments, **options):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        monkeypatch.setattr(os, "fsync", refuse)
        interrupt()

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert run(recording_folder, out, frames=before_frame(3, fill_the_disk)) != 0
    assert "--resume goes on" not in capsys.readouterr().err


def test_an_ablation_reaches_the_settings(recording_folder, tmp_path, capsys):
    out = tmp_path / "out"
    options = ["--ablation", "no-features", "--graph.no-enabled", "--graph.no-loops", "--reader.end", "3"]
    assert run(recording_folder, out, *options, "--no-evaluate") == 0
    slam = json.loads((out / "config.json").read_text())["slam"]
    assert slam["tracking"]["features"]["kind"] == "none"
    assert slam["graph"]["enabled"] is slam["graph"]["loops"] is False
    nothing = ["--ablation", "no-gicp", "--tracking.features.kind", "none"]
    assert run(recording_folder, tmp_path / "b", *nothing) == 2
    assert "nothing is left" in capsys.readouterr().err
    assert not (tmp_path / "b").exists()


@pytest.mark.usefixtures("no_warm_up")
def test_a_folder_that_can_no_longer_be_written_costs_no_results(
    recording_folder, tmp_path, monkeypatch, capsys
):
    out, refuge = tmp_path / "out", tmp_path / "refuge"
    refuge.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(refuge))

    def block():
        shutil.rmtree(out)
        out.write_text("")

    frames = before_frame(NUM_FRAMES - 1, block)
    assert run(recording_folder, out, "--no-evaluate", frames=frames) == 1
    (results,) = refuge.iterdir()
    assert str(results) in capsys.readouterr().err
    assert len(read_tum(results / "trajectory.txt")) == NUM_FRAMES
    assert np.sum(load_ply(results / "map.ply").valid) > 500
    assert json.loads((results / "config.json").read_text())["dataset"] == "folder"


@pytest.fixture(scope="module")
def stopped(recording_folder, tmp_path_factory):
    """The output folder of a run that was killed right after its last step."""
    out = tmp_path_factory.mktemp("runs") / "stopped"
    stopped_run([str(recording_folder), *SMALL, "--checkpoint-interval", "3"], out, step=3)
    return out


@pytest.mark.usefixtures("no_warm_up")
@pytest.mark.parametrize(
    "case", [("write", 10, False), ("fsync", 9, True)], ids=["in the evaluation", "from the first file on"]
)
def test_outputs_that_cannot_be_written_cost_nothing(finished, stopped, recording_folder, tmp_path, case):
    arguments = [str(recording_folder), *SMALL, "--checkpoint-interval", "3"]
    (found,) = failing_outputs(arguments, stopped, finished, tmp_path / "again", [case])
    assert found[1] == "same files", found


@pytest.mark.usefixtures("no_warm_up")
def test_a_folder_that_is_removed_in_mid_run_is_made_again(finished, recording_folder, tmp_path, capsys):
    out = tmp_path / "runs" / "out"
    frames = before_frame(5, lambda: shutil.rmtree(tmp_path / "runs"))
    assert run(recording_folder, out, "--checkpoint-interval", "3", frames=frames) == 0
    assert capsys.readouterr().err == (
        f"WARNING: {out} was removed while the run went on: it has been made again\n"
    )
    assert other_files(out, finished) == []
    assert {path.name for path in out.iterdir()} == WRITTEN
    assert "was removed" in (out / "run.log").read_text()


@pytest.mark.usefixtures("no_warm_up")
def test_a_folder_that_becomes_read_only_in_mid_run_costs_nothing(
    finished, recording_folder, tmp_path, monkeypatch, capsys
):
    out, refuge = tmp_path / "out", tmp_path / "refuge"
    refuge.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(refuge))
    with ExitStack() as stack:

        def frames(recording, *, first):
            for index, frame in prefetch(recording, first=first):
                if index == 2:
                    stack.enter_context(ReadOnly(out))
                if index == 11:
                    interrupt()
                yield index, frame

        options = ["--checkpoint-interval", "3", "--mapping.views-in-memory", "1"]
        assert run(recording_folder, out, *options, frames=frames) == 130
    told = capsys.readouterr().err.splitlines()
    (results,) = refuge.iterdir()
    kinds = ["WARNING", "WARNING", "ERROR", "Interrupted after 11 frames"]
    assert [re.split("[:;]", line)[0] for line in told] == kinds
    assert all("Read-only file system" in line for line in told[:3])
    assert told[2].endswith(f"the results are in {results}")
    assert told[3].endswith(f"--resume --out {results} goes on from there.")
    assert run(recording_folder, results, "--resume", *options) == 0
    assert other_files(results, finished) == ["config.json"]


@pytest.mark.usefixtures("no_warm_up")
def test_a_run_that_loses_a_tenth_of_its_frames_is_no_success(copy, tmp_path, capsys):
    for name in ("rgb", "depth"):
        for path in sorted((copy / name).iterdir())[8:10]:
            image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            assert cv2.imwrite(str(path), np.zeros_like(image))
    assert run(copy, tmp_path / "out", "--no-evaluate") == 1
    assert f"2 of {NUM_FRAMES} frames were lost, a tenth or more." in capsys.readouterr().err
    assert len(read_tum(tmp_path / "out" / "trajectory.txt")) == NUM_FRAMES - 2


def test_progress_names_the_compilation_and_the_refinement_has_an_end(recording_folder, tmp_path, capsys):
    out = tmp_path / "out"
    options = [word for word in SMALL if word != "--quiet"] + ["--reader.end", "3", "--no-evaluate"]
    assert main(["run", str(recording_folder), "--out", str(out), *options]) == 0
    shown = capsys.readouterr()
    lines = shown.err.splitlines()
    assert lines[0] == "frame 0 of 3, compiling (first run of this size, about a minute)"
    assert "refining the map, step 3 of 3" in lines
    # A summary also without the evaluation.
    assert "3 of 3 frames tracked" in shown.out
    assert f"metrics and report: sfgs-jax eval {out}" in shown.out
    assert f"look at the map: sfgs-jax view {out}" in shown.out


@pytest.mark.parametrize("arguments", [["fly"], ["run"], ["run", "synthetic", "--dataset", "kitti"]])
def test_wrong_commands_are_refused(arguments, capsys):
    try:
        status = main(arguments)
    except SystemExit as exit_:
        status = exit_.code
    assert status == 2
    assert capsys.readouterr().err


def test_a_run_of_nothing_prints_its_usage(capsys):
    assert main(["run"]) == 2
    assert capsys.readouterr().err.startswith("usage: sfgs-jax run SOURCE")


def test_a_folder_that_holds_no_run_is_named(finished, tmp_path, capsys):
    (tmp_path / "half").mkdir()
    shutil.copy(finished / "config.json", tmp_path / "half")
    for folder in (tmp_path / "none", tmp_path, tmp_path / "half", finished / "map.ply"):
        assert main(["eval", str(folder)]) == 2
        error = capsys.readouterr().err
        assert error.startswith(f"sfgs-jax: {folder} is not a run folder: ")
        assert len(error.splitlines()) == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["run", "synthetic", "--reader.camera", "nothere.json"], "nothere.json does not exist"),
        (["run", "synthetic", "--sensors", "nothere.json"], "Cannot read the sensors in nothere.json"),
        (["run", "synthetic", "--reader.stride", "0"], "stride must be a whole number of at least 1, not 0"),
        (["eval", "runs/x", "--every", "0"], "every must be a whole number of at least 1, not 0"),
        (["view", "runs/x", "--port", "70000"], "port must be a number between 0 and 65535, not 70000"),
    ],
)
def test_wrong_settings_get_one_sentence(arguments, words, capsys):
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("sfgs-jax: ")
    assert words in error
    assert len(error.splitlines()) == 1


def test_help_and_errors_list_the_same_layouts(capsys):
    assert main(["run", "synthetic", "--dataset", "kitti"]) == 2
    assert f"choose from {', '.join(LAYOUTS)}." in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["run", "--help-all"])
    text = " ".join(re.sub(r"[│╭╮╰╯─]", " ", capsys.readouterr().out).split())
    assert f"Layout of the recording: {', '.join(LAYOUTS)}." in text


def test_help_names_the_commands(capsys):
    assert main(["--help"]) == 0
    shown = capsys.readouterr().out
    assert all(name in shown for name in ("run", "eval", "view", "doctor"))


def test_a_run_goes_on_in_the_map_of_another(tmp_path, capsys):
    source, lost = "synthetic:frames=48,width=96,height=72", 4
    first, second = tmp_path / "monday", tmp_path / "tuesday"
    assert run(source, first, "--no-evaluate", "--keep-map") == 0
    assert (first / STORAGE).is_dir()
    assert run(source, second, "--no-evaluate", "--map", str(first)) == 0
    assert not (second / STORAGE).exists()
    # The camera may be anywhere: five frames have to be recognised at one place.
    poses, truth = read_tum(second / "trajectory.txt"), read_tum(second / GROUND_TRUTH_FILE)
    assert len(poses) == len(truth) - lost
    expected = (np.linalg.inv(truth.poses[0]) @ truth.poses[lost:])[:, :3, 3]
    np.testing.assert_allclose(poses.positions, expected, atol=0.025)
    log = (second / "run.log").read_text()
    assert log.count("its place in the map is not confirmed yet") == lost
    assert "WARNING" not in log
    before, after = (len(load_ply(folder / "map.ply").means) for folder in (first, second))
    assert after >= before
    assert json.loads((second / "config.json").read_text())["map"] == str(first)
    capsys.readouterr()
    assert run(source, first, "--map", str(first), "--overwrite") == 2
    assert "choose another folder" in capsys.readouterr().err
    assert run(source, tmp_path / "third", "--map", str(second)) == 2
    assert "--keep-map" in capsys.readouterr().err
    # A run that has ended keeps its map, even if somebody resumes it.
    assert run(source, first, "--no-evaluate", "--resume") == 0
    assert (first / STORAGE).is_dir()
    assert run(source, tmp_path / "nowhere", "--resume") == 2
    assert "no run that could be resumed" in capsys.readouterr().err
    # Another camera is refused before anything is overwritten.
    other = "synthetic:frames=4,width=80,height=60"
    assert run(other, second, "--map", str(first), "--overwrite") == 2
    assert "another camera" in capsys.readouterr().err
    assert len(load_ply(second / "map.ply").means) == after


def test_the_summary_counts_the_frames_that_have_no_pose(tmp_path):
    frames = {"total": 40, "tracked": 30, "lost": 4, "dropped": 5, "skipped": 1, "keyframes": 3}
    first, *_ = summary({"frames": frames}, tmp_path).splitlines()
    assert first == "30 of 40 frames tracked, 4 lost, 5 dropped, 1 skipped, 3 keyframes"
    first, *_ = summary({"frames": frames | {"lost": 0, "dropped": 0, "skipped": 0}}, tmp_path).splitlines()
    assert first == "30 of 40 frames tracked, 3 keyframes"
