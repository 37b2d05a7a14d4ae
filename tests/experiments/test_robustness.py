"""Figures of perturbed runs on fabricated paths, and one run from the recording to the table."""

from dataclasses import replace

import numpy as np
import pytest

from experiments import robustness
from experiments.robustness import Cell, append_cell, measure, opened, read_cells, row
from experiments.robustness_scores import Scores, scores
from experiments.starts import InMemory
from sfgs_jax.datasets import SyntheticRecording
from sfgs_jax.gicp import GicpConfig
from sfgs_jax.slam import PRESETS

NOTHING = np.zeros(60, bool)


@pytest.fixture
def truth():
    return SyntheticRecording(num_frames=60, width=32, height=24).ground_truth.poses.copy()


def moved(poses):
    """The same path in another world frame."""
    motion = np.eye(4)
    motion[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    motion[:3, 3] = (4, -2, 1)
    return motion @ poses


def test_a_right_path_in_its_own_frame(truth):
    found = scores(moved(truth), moved(truth), truth, NOTHING)
    assert (found.tracked, found.silent_wrong, found.recovery) == (1, 0, 0)
    assert found.auc == pytest.approx(1)
    assert found.worst_m < 1e-9


def test_a_path_that_goes_wrong_without_a_word(truth):
    live = truth.copy()
    live[40:52, :3, 3] += (0.2, 0, 0)
    live[52:55, :3, 3] += (0.05, 0, 0)
    found = scores(moved(live), moved(truth), truth, NOTHING)
    assert found.silent_wrong == pytest.approx(12 / 60)
    assert found.worst_m == pytest.approx(0.2)
    assert found.recovery == 12
    # The area is that of the final path.
    assert found.auc == pytest.approx(1)


def test_lost_frames_are_honest(truth):
    live = truth.copy()
    live[30:45] = np.nan
    found = scores(live, live, truth, NOTHING)
    assert (found.tracked, found.silent_wrong, found.recovery) == (0.75, 0, 15)
    assert found.auc == pytest.approx(0.75)
    # The first ten of them showed nothing.
    dark = (np.arange(60) >= 30) & (np.arange(60) < 40)
    assert scores(live, live, truth, dark).recovery == 5
    live[30:] = np.nan
    assert np.isnan(scores(live, live, truth, NOTHING).recovery)
    live[:] = np.nan
    found = scores(live, live, truth, NOTHING)
    assert (found.tracked, found.auc, found.silent_wrong) == (0, 0, 0)
    assert np.isnan([found.worst_m, found.recovery]).all()


def test_the_area_counts_errors_up_to_half_a_metre(truth):
    final = truth.copy()
    # Half of the frames are 40 cm apart from the others: 20 cm each after alignment, about.
    final[::2, :3, 3] += (0.4, 0, 0)
    found = scores(truth, final, truth, NOTHING)
    assert found.auc == pytest.approx(1 - 0.2 / 0.5, abs=0.03)


def test_cells_come_back_from_their_file(tmp_path):
    cells = {
        Cell("room", "motion blur", 3): Scores(1.0, 1 / 3, 0.0, 0.02, np.nan),
        Cell("room", "fog", "dynamic"): Scores(0.5, 0.25, 0.125, np.nan, 3.0),
    }
    file = tmp_path / "cells.csv"
    assert read_cells(file) == read_cells(None) == {}
    for cell, found in cells.items():
        append_cell(file, cell, found)
    assert repr(read_cells(file)) == repr(cells)


def test_a_row():
    line = row(Cell("room", "fog", "dynamic"), Scores(0.5, 0.25, 0.125, 0.031, np.nan))
    assert line == "| fog | dynamic | 50.0 | 25.0 | 12.5 | 3.1 | never |"


def test_sources_without_data_are_left_out(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(robustness.RECORDINGS, "redkitchen", str(tmp_path / "none"))
    assert opened("redkitchen", None) is None
    assert "no redkitchen" in capsys.readouterr().err


def test_blind_frames_are_lost_and_the_camera_is_found_again(monkeypatch, tmp_path, capsys):
    """One cell from the recording to the table; a second call takes it from the file."""
    config = PRESETS["synthetic"]
    gicp = replace(GicpConfig(), levels=1, strides=(1,))
    config = replace(config, tracking=replace(config.tracking, gicp=gicp))
    room = InMemory(SyntheticRecording(num_frames=14, width=96, height=72))
    found = measure(room, config, "black, no depth", 1)
    assert found.tracked == pytest.approx(11 / 14)
    assert found.silent_wrong == found.recovery == 0
    assert found.auc == pytest.approx(11 / 14, abs=0.03)
    assert found.worst_m < 0.05

    asked = []

    def measured(*what) -> Scores:
        asked.append(what[2:])
        return found

    monkeypatch.setattr(robustness, "measure", measured)
    monkeypatch.setattr(robustness, "opened", lambda *_: room)
    words = [
        "--only",
        "black, no depth",
        "gap",
        "--severities",
        "1",
        "3",
        "--csv",
        str(tmp_path / "cells.csv"),
    ]
    for _ in range(2):
        robustness.main(words)
    assert asked == [("black, no depth", 1), ("black, no depth", 3), ("gap", 1), ("gap", 3)]
    out = capsys.readouterr().out
    assert out.count("| black, no depth | 1 | 78.6 |") == 2
    assert "0.00 % on average over 4 cells" in out
