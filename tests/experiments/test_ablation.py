"""Starts of a recording, figures of a run, and the statistics that rank variants."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from experiments import ablation, ablation_runs
from experiments.ablation_runs import Run, append_run, errors, measure, read_runs
from experiments.ablation_tables import COLUMNS, differences, in_errors, log_ratio, mean_and_error, row
from experiments.held_out import HeldOut
from experiments.starts import Backward, InMemory, start_of, true_poses
from experiments.tracking import VARIANTS
from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import KinectFaults, Recording, SyntheticRecording

WHOLE, OTHER = "whole system", "GICP alone"


def run_of(variant=WHOLE, start=0, ate_m=0.02, tracked=1.0, recording="here", stride=1) -> Run:
    """A run with made-up figures."""
    figures = dict.fromkeys(("rpe_frame_m", "rpe_frame_deg", "rpe_second_m", "rpe_second_deg"), 0.1)
    return Run(
        recording, 40, stride, start, variant, tracked, ate_m, **figures, scale=1.0, surface_m=np.nan,
        reprojection_px=1 / 3, keyframes=4, loops=0,
    )  # fmt: skip


@pytest.fixture
def recording():
    return SyntheticRecording(num_frames=12, width=32, height=24, faults=KinectFaults(depth_delay=0.015))


def same(a, b) -> bool:
    return np.array_equal(a.rgb, b.rgb) and np.array_equal(a.depth, b.depth)


@pytest.mark.parametrize(
    ("start", "stride", "frames"),
    [(0, 1, range(12)), (4, 3, [4, 7, 10]), (1, 1, range(10, -1, -1)), (3, 4, [8, 4, 0]), (2, 8, [2, 10])],
)
def test_a_start_has_its_frames_with_their_poses_at_increasing_times(recording, start, stride, frames):
    selected = start_of(recording, start, stride)
    assert isinstance(selected, Recording)
    assert len(selected) == len(list(frames))
    assert same(selected[0], recording[frames[0]])
    assert same(selected[len(selected) - 1], recording[frames[-1]])
    steps = np.diff(selected.timestamps)
    np.testing.assert_allclose(steps, stride / 30)
    truth = selected.ground_truth
    assert truth is not None
    np.testing.assert_array_equal(truth.timestamps, selected.timestamps)
    np.testing.assert_array_equal(truth.poses, recording.ground_truth.poses[list(frames)])
    np.testing.assert_array_equal(true_poses(selected), truth.poses)
    assert [selected[i].timestamp for i in range(len(selected))] == selected.timestamps.tolist()


def test_backward_mirrors_the_time_of_depth_and_twice_backward_is_forward(recording):
    late = recording[3].depth_timestamp - recording[3].timestamp
    frame = Backward(recording)[8]
    assert same(frame, recording[3])
    assert frame.depth_timestamp - frame.timestamp == pytest.approx(-late)
    twice = Backward(Backward(recording))
    np.testing.assert_allclose(twice.timestamps, recording.timestamps, atol=1e-12)
    assert same(twice[5], recording[5])


def test_a_start_without_frames_is_refused(recording):
    with pytest.raises(InputError, match="fewer starts"):
        start_of(recording, 12, 1)


def test_frames_in_memory_are_decoded_once(recording):
    kept = InMemory(recording)
    assert kept[2] is kept[2]
    assert same(kept[2], recording[2])


def test_errors_of_a_path_of_half_the_size_with_a_lost_frame():
    selected = SyntheticRecording(num_frames=40, width=32, height=24)
    poses = true_poses(selected)
    assert errors(selected, poses)["ate_m"] < 1e-9
    poses[:, :3, 3] /= 2
    poses[7] = np.nan
    found = errors(selected, poses)
    assert found["scale"] == pytest.approx(2)
    assert found["ate_m"] > 0.01
    assert found["rpe_second_deg"] == pytest.approx(0, abs=1e-5)
    assert found["rpe_second_m"] > 3 * found["rpe_frame_m"] > 0


def test_errors_that_need_more_poses_are_unknown():
    selected = SyntheticRecording(num_frames=40, width=32, height=24)
    poses = true_poses(selected)
    poses[5:] = np.nan
    found = errors(selected, poses)
    assert found["rpe_frame_m"] < 1e-9
    assert np.isnan(found["rpe_second_m"])
    poses[:] = np.nan
    assert all(map(np.isnan, errors(selected, poses).values()))


def test_held_out_figures_grow_with_the_error_of_poses():
    selected = start_of(InMemory(SyntheticRecording(num_frames=96)), 0, 8)
    held_out, poses = HeldOut(selected, 8), true_poses(selected)
    bent = poses.copy()
    bent[6:, :3, 3] += 0.03
    assert held_out.surface_m(poses) < 0.002
    assert held_out.surface_m(bent) > 0.005
    assert held_out.reprojection_px(poses) < 2
    assert held_out.reprojection_px(bent) > 1.5 * held_out.reprojection_px(poses)
    poses[:] = np.nan
    assert np.isnan([held_out.surface_m(poses), held_out.reprojection_px(poses)]).all()


def test_a_run_counts_lost_frames(recording, monkeypatch):
    class State:
        class graph:
            keyframes, loops = (1, 2, 3), (1,)

    poses = true_poses(recording)
    poses[:3] = np.nan
    monkeypatch.setattr(ablation_runs, "tracked_poses", lambda *_: (poses, State))
    run = measure(recording, HeldOut(recording, 1), VARIANTS[WHOLE], ("here", 12, 1, 0, WHOLE))
    assert (run.tracked, run.keyframes, run.loops) == (0.75, 3, 1)
    assert run.ate_m < 1e-9


def test_mean_and_standard_error():
    mean, error = mean_and_error(np.array([1.0, 2.0, 3.0, 6.0]))
    assert (mean, error) == (3.0, pytest.approx(np.sqrt(14 / 3) / 2))
    assert mean_and_error(np.array([5.0]))[0] == 5
    assert np.isnan(mean_and_error(np.array([5.0]))[1])
    assert np.isnan(mean_and_error(np.array([]))).all()
    assert in_errors(0.0, 0.0) == 0
    assert in_errors(-1.0, 0.5) == -2
    assert in_errors(-1.0, 0.0) == -np.inf


def test_differences_are_paired_and_leave_lost_starts_out():
    runs = [run_of(WHOLE, n, 0.02 + 0.01 * n) for n in range(4)]
    runs += [run_of(OTHER, n, 0.023 + 0.01 * n) for n in range(2)]
    runs += [run_of(OTHER, 2, 9.0, tracked=0.4), run_of(OTHER, 3, np.nan)]
    found = differences(runs, OTHER, WHOLE, "ate_m")
    assert found == {("here", 1, n): pytest.approx(0.003) for n in range(2)}
    cells = dict(zip(COLUMNS, row(runs, OTHER, WHOLE), strict=True))
    assert cells["starts"] == "3 / 4"
    assert cells["tracked %"] == "85.0"
    assert cells["ATE cm"] == "2.80 ± 0.50"
    assert cells["difference to whole cm"] == "+0.30 ± 0.00"
    assert cells["surfaces apart cm"] == "-"


def test_log_ratio_weighs_tables_alike_and_has_both_errors():
    logs = {("a", 1): [0.1, 0.3], ("a", 3): [0.0, 0.0, 0.0], ("b", 1): [0.5, 0.7]}
    runs = []
    for (name, stride), values in logs.items():
        for start, value in enumerate(values):
            runs.append(run_of(WHOLE, start, 0.02 * (start + 1), recording=name, stride=stride))
            runs.append(replace(runs[-1], variant=OTHER, ate_m=runs[-1].ate_m * np.exp(value)))
    mean, over_starts, over_recordings = log_ratio(runs, OTHER, WHOLE, "ate_m")
    assert mean == pytest.approx((0.2 + 0.0 + 0.6) / 3)
    assert over_starts == pytest.approx(np.sqrt(0.1**2 + 0.1**2) / 3)
    assert over_recordings == pytest.approx(np.std([0.1, 0.6], ddof=1) / np.sqrt(2))
    assert np.isnan(log_ratio(runs, OTHER, WHOLE, "surface_m")).all()


def test_a_recording_may_be_a_source(tmp_path, capsys):
    made_up = "synthetic:kinect=1,seed=2"
    assert ablation.parse(["--recordings", "noise", made_up, str(tmp_path)]).recordings[1] == made_up
    with pytest.raises(SystemExit):
        ablation.parse(["--recordings", "attic"])
    assert "There is no recording attic; names are redkitchen, fr1_rpy, " in capsys.readouterr().err


def test_runs_come_back_from_their_file(tmp_path):
    runs, file = [run_of(OTHER, 3, 1 / 3), run_of()], tmp_path / "runs.csv"
    assert read_runs(file) == []
    for run in runs:
        append_run(file, run)
    assert list(map(repr, read_runs(file))) == list(map(repr, runs))


def test_an_interrupted_table_goes_on(tmp_path, monkeypatch, capsys):
    """The whole system is added, runs of the file are skipped, and the tables have both kinds."""
    recording = SyntheticRecording(num_frames=30, width=32, height=24)
    monkeypatch.setattr(ablation, "open_recording", lambda *_, **__: recording)
    asked = []

    def measure(selected, held_out, config, key) -> Run:
        asked.append(key)
        if len(asked) == 3:
            raise KeyboardInterrupt
        name, frames, stride, start, variant = key
        return replace(run_of(variant, start, 0.02 + 0.01 * start, 1.0, name, stride), frames=frames)

    monkeypatch.setattr(ablation, "measure", measure)
    words = f"--recordings kinect --strides 1 3 --starts 2 --csv {tmp_path / 'runs.csv'} --variants".split()
    with pytest.raises(KeyboardInterrupt):
        ablation.main([*words, OTHER])
    ablation.main([*words, OTHER])
    every = [("kinect", 30, *rest) for rest in product((1, 3), (0, 1), (WHOLE, OTHER))]
    assert asked == [*every[:3], *every[2:]]
    out = capsys.readouterr().out
    assert "kinect, every 3. of 30 frames" in out
    assert "All recordings, strides 1, 3" in out
    assert "| GICP alone | 0 / 0 / 4 | 1.000 | +0.000 ± 0.000 |" in out
