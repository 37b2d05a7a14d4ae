"""`sfgs-jax merge`: a run folder out of two, and one sentence where that can't be made."""

import dataclasses
import inspect
import json
import shutil

import numpy as np
import pytest

from sfgs_jax import slam
from sfgs_jax.cli import main, merge_command, read_config, to_json
from sfgs_jax.geometry import read_tum
from sfgs_jax.slam import GROUND_TRUTH_FILE, STORAGE, load_run
from sfgs_jax.slam.run import read_tensors, write_tensors
from sfgs_jax.splatting import load_ply

ROOM = "synthetic:frames=48,width=96,height=72"
SMALL = [
    *("--mapping.capacity", "8192", "--mapping.pair-capacity", "32768", "--mapping.final-steps", "3"),
    *("--tracking.gicp.levels", "1", "--graph.map-support", "2", "--no-evaluate", "--quiet"),
]

pytestmark = pytest.mark.usefixtures("own_compilation_cache", "no_warm_up")


@pytest.fixture(scope="module")
def no_warm_up():
    """Programs are compiled when they are called first, and some never are."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(inspect.getmodule(slam.run), "warm_up", lambda camera, config: None)
        yield


def run(out, start, end, *options, source=ROOM):
    frames = ("--reader.start", str(start), "--reader.end", str(end))
    return main(["run", source, "--out", str(out), *frames, *SMALL, *options])


@pytest.fixture(scope="module")
def runs(tmp_path_factory, own_compilation_cache, no_warm_up):
    """Folder of two runs whose maps were kept."""
    folder = tmp_path_factory.mktemp("runs")
    assert run(folder / "monday", 0, 30, "--keep-map") == 0
    assert run(folder / "tuesday", 16, 48, "--keep-map") == 0
    return folder


@pytest.fixture(scope="module")
def both(runs):
    out = runs / "deep" / "both"
    assert main(["merge", str(runs / "monday"), str(runs / "tuesday"), "--out", str(out), "--quiet"]) == 0
    return out


def refused(capsys, *arguments):
    """The sentence with which the command refuses."""
    capsys.readouterr()
    assert main(["merge", *map(str, arguments)]) == 2
    error = capsys.readouterr().err
    assert error.startswith("sfgs-jax: ")
    assert len(error.splitlines()) == 1
    return error


def test_the_result_is_a_run_of_both_recordings(runs, both):
    truth = read_tum(runs / "monday" / GROUND_TRUTH_FILE)
    all_poses = read_tum(runs / "tuesday" / GROUND_TRUTH_FILE)
    for name, known in (("trajectory.txt", truth), ("trajectory_recording_2.txt", all_poses)):
        found = read_tum(both / name)
        np.testing.assert_allclose(found.timestamps, known.timestamps, atol=1e-5)
        expected = (np.linalg.inv(truth.poses[0]) @ known.poses)[:, :3, 3]
        assert np.linalg.norm(found.positions - expected, axis=1).max() < 0.03
    assert (both / GROUND_TRUTH_FILE).read_bytes() == (runs / "monday" / GROUND_TRUTH_FILE).read_bytes()
    counts = [len(load_ply(folder / "map.ply").means) for folder in (runs / "monday", runs / "tuesday", both)]
    assert max(counts[:2]) <= counts[2] < 0.8 * sum(counts[:2])
    metrics = json.loads((both / "metrics.json").read_text())
    assert metrics["frames"]["total"] == metrics["frames"]["tracked"] == 62
    assert metrics["map"]["number"] == 1
    assert metrics["merged"] == [str(runs / "monday"), str(runs / "tuesday")]
    assert "fps" not in metrics
    assert read_config(both / "config.json") == read_config(runs / "monday" / "config.json")
    assert sorted(path.name for path in both.parent.iterdir()) == ["both"]


def test_a_run_goes_on_in_the_result(both, tmp_path):
    assert run(tmp_path / "wednesday", 30, 46, "--map", str(both)) in (0, 1)  # four of so few are lost
    found, truth = read_tum(tmp_path / "wednesday" / "trajectory.txt"), read_tum(both / GROUND_TRUTH_FILE)
    known = read_tum(tmp_path / "wednesday" / GROUND_TRUTH_FILE)
    assert len(found) == len(known) - 4
    expected = (np.linalg.inv(truth.poses[0]) @ known.poses[4:])[:, :3, 3]
    assert np.linalg.norm(found.positions - expected, axis=1).max() < 0.03


def test_other_commands_read_the_result(both, tmp_path, capsys):
    assert main(["export", str(both), str(tmp_path / "room.spz")]) == 0
    assert main(["render", str(both), "--out", str(tmp_path / "images"), "--every", "20"]) == 0
    assert "2 images of 96x72" in capsys.readouterr().out


def test_the_merged_map_is_refined_for_as_long_as_asked(runs, tmp_path, capsys):
    out = tmp_path / "refined"
    words = ["merge", str(runs / "tuesday"), str(runs / "monday"), "--out", str(out), "--refine", "0.2"]
    assert main(words) == 0
    assert f"results: {out}" in capsys.readouterr().out
    config = read_config(out / "config.json").slam
    assert config.mapping.final_seconds == 0.2
    kept = load_run(out / STORAGE, config)
    assert kept.refinement_ms >= 200
    assert kept.state.mapping.num_steps > 6


def test_bad_input_gets_one_sentence(runs, both, tmp_path, capsys):
    monday, tuesday = runs / "monday", runs / "tuesday"
    new = ("--out", tmp_path / "new")
    assert "folders of two runs" in refused(capsys, monday, runs / "deep" / ".." / "monday", *new)
    assert "holds no map" in refused(capsys, monday, tmp_path / "nowhere", *new)
    assert f"{both} exists" in refused(capsys, monday, tuesday, "--out", both)
    assert "refine must be" in refused(capsys, monday, tuesday, *new, "--refine", "-1")
    other = shutil.copytree(tuesday, tmp_path / "other")
    shutil.rmtree(other / STORAGE)
    assert "--keep-map" in refused(capsys, monday, other, *new)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(("error", "status"), [(OSError(28, "No space left"), 1), (KeyboardInterrupt(), 130)])
def test_nothing_is_left_of_a_result_that_could_not_be_written(error, status, runs, tmp_path, monkeypatch):
    def write_run(run, folder):
        (folder / "trajectory.txt").write_text("half")
        raise error

    monkeypatch.setattr(inspect.getmodule(merge_command), "write_run", write_run)
    words = ["merge", str(runs / "monday"), str(runs / "tuesday"), "--out", str(tmp_path / "new"), "--quiet"]
    assert main(words) == status
    assert not list(tmp_path.iterdir())


def test_runs_that_do_not_fit_are_refused(runs, tmp_path, capsys):
    monday, new = runs / "monday", ("--out", tmp_path / "new")
    source = "synthetic:frames=48,width=96,height=72,seed=5"
    assert run(tmp_path / "elsewhere", 0, 6, "--keep-map", source=source) == 0
    assert "No place of the second run" in refused(capsys, monday, tmp_path / "elsewhere", *new, "--quiet")
    state = tmp_path / "elsewhere" / STORAGE / "state.safetensors"
    config = read_config(tmp_path / "elsewhere" / "config.json")
    changed = dataclasses.replace(config, slam=dataclasses.replace(config.slam, seed=3))
    (tmp_path / "elsewhere" / "config.json").write_text(to_json(changed))
    assert "other settings" in refused(capsys, monday, tmp_path / "elsewhere", *new)
    tensors, metadata = read_tensors(state)
    write_tensors(state, tensors, metadata | {"version": "3"})
    assert "of format 3" in refused(capsys, monday, tmp_path / "elsewhere", *new)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["elsewhere"]
