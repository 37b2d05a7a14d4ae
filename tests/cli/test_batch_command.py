"""`sfgs-jax batch`: a list of recordings, of which one was stopped before and one is not there."""

import csv
import math
import os
import re
import shlex
import signal
import threading
import time
from functools import partial

import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.cli import (
    COMMANDS,
    Command,
    Outcome,
    batch_table,
    limited,
    main,
    read_list,
    read_record,
    run_command,
    write_record,
)
from sfgs_jax.datasets import SyntheticRecording, prefetch, write_recording
from sfgs_jax.geometry import read_tum

pytestmark = pytest.mark.usefixtures("own_compilation_cache")
NUM_FRAMES = 4
# Settings of a test of `run`, whose programs serve here as well: the smallest system that tracks and maps.
SMALL = shlex.split(
    "--mapping.capacity 8192 --mapping.pair-capacity 32768 --mapping.final-steps 3 --tracking.gicp.levels 1 "
    "--ablation no-features --graph.no-enabled --graph.no-loops --no-evaluate"
)


@pytest.fixture(scope="module")
def recording_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recordings") / "my room"
    write_recording(SyntheticRecording(num_frames=NUM_FRAMES, width=96, height=72), folder, layout="folder")
    return folder


@pytest.fixture
def words(recording_folder):
    return [str(recording_folder), *SMALL]


def write_list(folder, *lines):
    path = folder / "list.txt"
    path.write_text("\n".join(lines) + "\n")
    return path


def stopped_at_frame(recording, *, first):
    """The frames before the second one, and then Ctrl-C."""
    for index, frame in prefetch(recording, first=first):
        if index == 2:
            raise KeyboardInterrupt
        yield index, frame


def test_a_batch_goes_on_and_a_failure_costs_no_other_recording(words, tmp_path, capsys):
    out, folder = tmp_path / "out", tmp_path / "out" / "my-room"
    missing = tmp_path / "missing"
    path = write_list(tmp_path, "# two", shlex.join(words), "", f"{missing} --reader.end 3 # gone")
    out.mkdir()
    stopped = {**COMMANDS, "run": Command(partial(run_command, frames=stopped_at_frame), "")}
    assert main(["run", *words, "--out", str(folder), "--quiet"], commands=stopped) == 130
    write_record(
        out / "batch.csv", [Outcome("my-room", shlex.join(words), "interrupted", 4, 2, seconds=100.0)]
    )
    capsys.readouterr()

    assert main(["batch", str(path), "--out", str(out), "--jobs", "2"]) == 1
    shown = capsys.readouterr().out.splitlines()
    assert shown[-3].split()[:5] == ["my-room", "done", "4", "of", "4"]
    assert shown[-2].split() == ["missing", "failed", "-", "-", "-", shown[-2].split()[-1]]
    assert shown[-1] == f"missing: There is no {missing}."
    assert len(read_tum(folder / "trajectory.txt")) == NUM_FRAMES
    assert "going on after frame 1" in (folder / "run.log").read_text()
    assert not (folder / "state").exists()
    with (out / "batch.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["state"] for row in rows] == ["done", "failed"]
    assert rows[0]["tracked"] == rows[0]["frames"] == "4"
    # The time before the interruption counts.
    assert 100 < float(rows[0]["seconds"]) < 400
    assert rows[1]["ate_m"] == rows[1]["psnr_db"] == ""
    assert rows[1]["message"] == f"There is no {missing}."

    # What is finished is left alone: with one line there is nothing to start.
    log = (folder / "run.log").stat().st_mtime_ns
    path = write_list(tmp_path, shlex.join(words))
    assert main(["batch", str(path), "--out", str(out)]) == 0
    assert capsys.readouterr().out.splitlines()[0] == "1 of 1 finished before"
    assert (folder / "run.log").stat().st_mtime_ns == log
    # Another recording, or other options, does not get these results.
    path = write_list(tmp_path, shlex.join([*words, "--reader.end", "3"]))
    assert main(["batch", str(path), "--out", str(out)]) == 2
    assert "not with this source and these options" in capsys.readouterr().err


def test_an_interrupted_batch_stops_its_runs_and_says_so(words, tmp_path, capsys):
    out = tmp_path / "out"
    path = write_list(tmp_path, shlex.join(words), shlex.join(words))

    def interrupt():
        end = time.monotonic() + 120
        while not (out / "my-room" / "config.json").exists() and time.monotonic() < end:
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGTERM)

    thread = threading.Thread(target=interrupt)
    thread.start()
    assert main(["batch", str(path), "--out", str(out), "--jobs", "1"]) == 130
    thread.join()
    shown = capsys.readouterr()
    assert "Interrupted; the same command goes on." in shown.err
    # The second one was not begun.
    (row,) = read_record(out / "batch.csv").values()
    assert (row.name, row.state) == ("my-room", "interrupted")
    assert "goes on when the batch is started again" in shown.out


def test_a_folder_that_is_not_the_batchs_own_is_left_alone(words, tmp_path, capsys):
    folder = tmp_path / "out" / "my-room"
    folder.mkdir(parents=True)
    (folder / "thesis.txt").write_text("mine")
    path = write_list(tmp_path, "", shlex.join(words))
    for _ in range(2):
        assert main(["batch", str(path), "--out", str(folder.parent)]) == 2
        error = capsys.readouterr().err
        assert f"Line 2: {folder} holds something that is no run of this batch" in error
        assert len(error.splitlines()) == 1
    assert os.listdir(folder) == ["thesis.txt"]
    assert not (folder.parent / "batch.csv").exists()


def test_a_list_has_a_recording_in_each_line(tmp_path):
    lines = ("", "a/room", "'b/my room' --reader.end 3  # short", "c/room", "synthetic:frames=9,width=40")
    found = read_list(write_list(tmp_path, *lines))
    assert [entry.line for entry in found] == [2, 3, 4, 5]
    assert [entry.name for entry in found] == ["room", "my-room", "room-2", "synthetic-frames-9-width-40"]
    assert found[1].words == ("b/my room", "--reader.end", "3")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("room --foo 3", "Unrecognized options: --foo, 3."),
        ("room --mapping.final-steps many", "Error parsing --mapping.final-steps"),
        ("room --reader.stride 0", "stride must be a whole number of at least 1, not 0"),
        ("room --out elsewhere", "--out is no option of one recording in a batch"),
        ("room --resume", "--resume is no option of one recording in a batch"),
        ("room --help-all", "--help-all"),
        ("--quiet room", "begins with a recording, not with the option '--quiet'"),
        ("'room", "No closing quotation"),
    ],
)
def test_errors_name_the_line(line, words, tmp_path, capsys):
    path = write_list(tmp_path, "synthetic", line)
    assert main(["batch", str(path), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"sfgs-jax: {path}, line 2: ")
    assert words in error
    assert len(error.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_lists_and_records_that_cannot_be_read(tmp_path, capsys):
    for content, words in ((b"# nothing\n", "names no recording"), (b"\xff\xfe\x00", "Cannot read the list")):
        (tmp_path / "list.txt").write_bytes(content)
        assert main(["batch", str(tmp_path / "list.txt")]) == 2
        assert words in capsys.readouterr().err
    with pytest.raises(InputError, match="Cannot read the list"):
        read_list(tmp_path / "none.txt")
    (tmp_path / "batch.csv").write_text("name,state\nroom,lost\n")
    with pytest.raises(InputError, match="is no record of a batch"):
        read_record(tmp_path / "batch.csv")


def test_the_record_comes_back_and_the_table_has_its_figures(tmp_path):
    outcomes = [
        Outcome("room", "room", "done", 120, 118, 0.0123, 31.256, 61.4),
        Outcome("hall", "a/hall --quiet", "failed", message="There is no a/hall."),
    ]
    assert read_record(tmp_path / "batch.csv") == {}
    write_record(tmp_path / "batch.csv", outcomes)
    found = read_record(tmp_path / "batch.csv")
    assert found["room"] == outcomes[0]
    assert math.isnan(found["hall"].psnr_db)
    lines = batch_table(list(found.values())).splitlines()
    assert re.split(r"\s{2,}", lines[1]) == ["room", "done", "118 of 120", "1.23", "31.26", "61"]
    assert re.split(r"\s{2,}", lines[2]) == ["hall", "failed", "-", "-", "-", "0"]
    assert len({len(line) for line in lines[:3]}) == 1
    assert lines[3] == "hall: There is no a/hall."


def test_runs_share_the_cores():
    found = limited({"PATH": "/bin", "OMP_NUM_THREADS": "3"}, 2)
    assert found["NPROC"] == found["OPENBLAS_NUM_THREADS"] == "2"
    assert (found["PATH"], found["OMP_NUM_THREADS"]) == ("/bin", "3")
