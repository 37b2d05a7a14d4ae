import csv
import dataclasses
import json
import shutil

import numpy as np
import pytest

from sfgs_jax.arrays import FrameError, InputError
from sfgs_jax.evaluation import PROTOCOLS, MapRenderer, evaluate_run
from sfgs_jax.geometry import Camera, Trajectory, format_tum, read_tum
from sfgs_jax.sensors import format_gains
from sfgs_jax.splatting import format_background, load_ply
from tests.evaluation.fabricated_run import path


def frames_by_protocol(every, splatam, views, held_out):
    """Counts of frames, where most protocols take every frame that was evaluated."""
    return dict.fromkeys(PROTOCOLS, every) | {"splatam": splatam, "views": views, "held_out": held_out}


@pytest.fixture
def run(fabricated, tmp_path, monkeypatch):
    """A copy of the run's folder, and its recording; no weights are to be found."""
    monkeypatch.setenv("SFGS_DATA", str(tmp_path / "nothing"))
    folder = tmp_path / "run"
    shutil.copytree(fabricated[0], folder)
    return folder, fabricated[1]


def test_a_run_that_is_its_own_recording_is_exact(run):
    folder, recording = run
    done = []
    metrics = evaluate_run(folder, recording, progress=done.append)
    assert done == list(range(1, 12))
    assert metrics["ate"]["rmse_m"] < 1e-8
    assert metrics["ate"]["num_pairs"] == 11
    assert metrics["rpe"]["trans_m"] < 1e-8
    assert set(metrics["psnr"]) == set(metrics["ssim"]) == set(PROTOCOLS)
    assert min(metrics["psnr"].values()) > 80
    assert min(metrics["ssim"].values()) > 0.9999
    assert metrics["evaluated"]["frames"] == frames_by_protocol(11, 3, 3, 1)
    assert "Cannot read the LPIPS weights" in metrics["unavailable"]["lpips_squeeze"]


def test_the_file_is_what_is_returned_and_keeps_the_runs_own_part(run):
    folder, recording = run
    metrics = evaluate_run(folder, recording)
    assert json.loads((folder / "metrics.json").read_text()) == metrics
    assert metrics["stages"]["tracking"] == {"median_ms": 12.5, "p95_ms": 20.0}
    assert metrics["frames"]["tracked"] == 11


def test_doing_it_again_changes_nothing(run):
    folder, recording = run
    evaluate_run(folder, recording)
    first = (folder / "metrics.json").read_bytes()
    evaluate_run(folder, recording)
    assert (folder / "metrics.json").read_bytes() == first


def test_without_ground_truth_it_says_so_and_forgets_old_figures(run):
    folder, recording = run
    metrics = evaluate_run(folder, dataclasses.replace(recording, ground_truth=None))
    assert (
        metrics["unavailable"]["ate"] == metrics["unavailable"]["rpe"] == "the recording has no ground truth"
    )
    assert "ate" not in metrics
    assert metrics["psnr"]["all"] > 80


def test_wrong_poses_lower_the_figures(run):
    folder, recording = run
    trajectory = read_tum(folder / "trajectory.txt")
    trajectory.poses[5, 0, 3] += 0.1
    (folder / "trajectory.txt").write_text(format_tum(trajectory))
    metrics = evaluate_run(folder, recording)
    assert 0.05 < metrics["ate"]["max_m"] < 0.1
    assert metrics["psnr"]["all"] < 100 - (100 - 40) / 11
    assert metrics["psnr"]["splatam"] > 80  # frame 5 is not one of SplaTAM's


def test_lost_and_unreadable_frames_are_left_out_and_counted(run):
    folder, recording = run
    trajectory = read_tum(folder / "trajectory.txt")
    kept = np.setdiff1d(np.arange(11), [0, 7])
    (folder / "trajectory.txt").write_text(format_tum(trajectory[kept]))
    frames = list(recording.frames)
    frames[3] = FrameError("truncated")
    metrics = evaluate_run(folder, dataclasses.replace(recording, frames=frames))
    assert metrics["evaluated"]["frames"] == frames_by_protocol(8, 2, 2, 1)
    assert metrics["evaluated"]["without_pose"] == 2
    assert metrics["evaluated"]["unreadable"] == 1
    assert metrics["psnr"]["all"] > 80


def test_a_subset_is_stated(run):
    folder, recording = run
    metrics = evaluate_run(folder, recording, every=3)
    assert metrics["evaluated"]["every"] == 3
    # Frames 2, 5 and 8, of which 5 is a keyframe and none is SplaTAM's; and 4, which is held out.
    assert metrics["evaluated"]["frames"] == frames_by_protocol(3, 0, 1, 1)
    assert "psnr.splatam" in metrics["unavailable"]
    with pytest.raises(InputError, match="at least 1"):
        evaluate_run(folder, recording, every=0)


def test_long_recordings_are_sampled_as_splatam_does(run):
    folder, recording = run
    assert evaluate_run(folder, recording)["evaluated"]["every"] == 1
    metrics = evaluate_run(folder, recording, max_pixels=3 * 64 * 48)
    assert metrics["evaluated"]["every"] == 5
    assert metrics["evaluated"]["frames"] == frames_by_protocol(2, 2, 0, 1)  # 4 and 9


def test_protocols_without_frames_are_unavailable(run):
    folder, recording = run
    shutil.copy(folder / "trajectory.txt", folder / "keyframes.txt")
    metrics = evaluate_run(folder, recording)
    assert "held_out" not in metrics["psnr"]
    assert {"psnr.held_out", "ssim.held_out"} <= set(metrics["unavailable"])


def test_a_run_without_any_pose_has_no_figures(run):
    folder, recording = run
    for name in ("trajectory.txt", "keyframes.txt"):
        (folder / name).write_text(format_tum(Trajectory(np.zeros(0), np.zeros((0, 4, 4)))))
    metrics = evaluate_run(folder, recording)
    assert {"ate", "rpe", "psnr", "ssim", "lpips_squeeze"} <= set(metrics["unavailable"])
    assert "psnr" not in metrics


def test_frames_have_a_line_each(run):
    folder, recording = run
    gains = np.tile([1.0, 1.25, 0.8], (11, 1))
    gains[5] = [0.5, 0.5, 0.5]
    (folder / "exposure.txt").write_text(format_gains(read_tum(folder / "trajectory.txt").timestamps, gains))
    metrics = evaluate_run(folder, recording)
    with (folder / "frames.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["index"]) for row in rows] == list(range(11))
    assert [int(row["view"]) for row in rows] == [i in (0, 5, 10) for i in range(11)]
    mean = np.mean([float(row["psnr_gs_icp"]) for row in rows])
    assert metrics["psnr"]["gs_icp"] == pytest.approx(mean, abs=1e-3)
    assert float(rows[5]["psnr_gs_icp"]) < 20 < 80 < float(rows[5]["psnr_gs_icp_raw"])
    assert [float(rows[5][f"gain_{channel}"]) for channel in "rgb"] == [0.5] * 3
    assert rows[3]["psnr_held_out"] == "" != rows[4]["psnr_held_out"]
    assert float(rows[4]["position_error_m"]) < 1e-6
    assert metrics["depth_l1_m"] < 1e-3 < 0.2 < metrics["coverage"] <= 1


def test_gains_of_other_frames_are_refused(run):
    folder, recording = run
    (folder / "exposure.txt").write_text(format_gains(np.arange(3.0), np.ones((3, 3))))
    with pytest.raises(InputError, match=r"exposure.txt is of other frames"):
        evaluate_run(folder, recording)
    (folder / "exposure.txt").write_text("1.0 0.5 -1 1\n")
    with pytest.raises(InputError, match="not finite and positive"):
        evaluate_run(folder, recording)


def test_the_background_of_a_run_shows_where_its_map_has_nothing(run):
    """The recording shows a grey wall there, as the background does."""
    folder, recording = run
    holes = Camera(12.0, 12.0, 31.5, 23.5, width=64, height=48)
    render, frames = MapRenderer(load_ply(folder / "map.ply"), holes), []
    for place, pose in enumerate(path().poses):
        output = render(pose)
        share = np.clip(1 - 2 * np.asarray(output.alpha), 0, 1)[..., None]
        rgb = np.clip(np.asarray(output.rgb) + 0.5 * share, 0, 1)
        frames.append(dataclasses.replace(recording.frames[place], rgb=rgb, depth=np.array(output.depth)))
    recording = dataclasses.replace(recording, frames=frames, camera=holes)
    without = evaluate_run(folder, recording)["psnr"]["all"]
    (folder / "background.txt").write_text(format_background(np.zeros((9, 3))))
    assert without < 10 < 70 < evaluate_run(folder, recording)["psnr"]["all"]
    (folder / "background.txt").write_text("0.5 0.5\n")
    with pytest.raises(InputError, match=r"background.txt"):
        evaluate_run(folder, recording)


def test_lpips_of_some_of_splatams_frames(run, sfgs_data, monkeypatch):
    monkeypatch.setenv("SFGS_DATA", str(sfgs_data))
    folder, recording = run
    metrics = evaluate_run(folder, recording, max_lpips_frames=2)
    assert set(metrics["lpips_squeeze"]) == {"splatam"}
    assert metrics["lpips_squeeze"]["splatam"] < 1e-4
    assert metrics["evaluated"]["lpips_frames"] == 2
    assert metrics["unavailable"] == {}


def test_another_recording_and_missing_files_are_refused(run):
    folder, recording = run
    other = dataclasses.replace(recording, timestamps=recording.timestamps + 100)
    with pytest.raises(InputError, match="made on another recording"):
        evaluate_run(folder, other)
    (folder / "map.ply").unlink()
    with pytest.raises(InputError, match="map"):
        evaluate_run(folder, recording)
    (folder / "metrics.json").write_text("{half")
    with pytest.raises(InputError, match="Cannot read"):
        evaluate_run(folder, recording)
