"""`sfgs-jax batch --scheduler`: the runs of a batch at the workers of a Dask cluster."""

import os
import shlex
import signal
import threading
import time
from pathlib import Path

import dask.config
import pytest
from distributed import LocalCluster

from sfgs_jax.cli import main, read_record
from sfgs_jax.datasets import SyntheticRecording, write_recording
from sfgs_jax.geometry import read_tum

pytestmark = pytest.mark.usefixtures("own_compilation_cache")
# The system of the tests of a batch on one machine.
SMALL = shlex.split(
    "--mapping.capacity 8192 --mapping.pair-capacity 32768 --mapping.final-steps 3 --tracking.gicp.levels 1 "
    "--ablation no-features --graph.no-enabled --graph.no-loops --no-evaluate"
)


def local_cluster(workers):
    """A cluster in this process, whose messages take the way of one of many machines."""
    return LocalCluster(
        n_workers=workers,
        threads_per_worker=2,
        processes=False,
        protocol="tcp://",
        dashboard_address=":0",
    )


@pytest.fixture(scope="module")
def scheduler():
    cluster = local_cluster(1)
    yield cluster.scheduler_address
    cluster.close()


@pytest.fixture(scope="module")
def words(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recordings") / "room"
    write_recording(SyntheticRecording(num_frames=4, width=96, height=72), folder, layout="folder")
    return [str(folder), *SMALL]


def test_the_workers_make_the_runs_and_a_failure_costs_no_other(
    words, scheduler, tmp_path, monkeypatch, capsys
):
    # Relative paths begin where the batch was started.
    monkeypatch.chdir(tmp_path)
    os.symlink(words[0], "room")
    (tmp_path / "list.txt").write_text(f"{shlex.join(['room', *words[1:]])}\nmissing\n")
    assert main(["batch", "list.txt", "--scheduler", scheduler]) == 1
    shown = capsys.readouterr().out.splitlines()
    assert shown[-3].split()[:5] == ["room", "done", "4", "of", "4"]
    assert shown[-1] == "missing: There is no missing."
    out = tmp_path / "runs" / "list"
    assert len(read_tum(out / "room" / "trajectory.txt")) == 4
    assert [row.state for row in read_record(out / "batch.csv").values()] == ["done", "failed"]
    assert (out / "room.log").exists()

    # What is finished is left alone, wherever it was made.
    (tmp_path / "list.txt").write_text(f"{shlex.join(['room', *words[1:]])}\n")
    assert main(["batch", "list.txt"]) == 0
    assert capsys.readouterr().out.splitlines()[0] == "1 of 1 finished before"


def test_an_interrupted_batch_stops_the_runs_at_the_workers(scheduler, tmp_path, capsys):
    out = tmp_path / "out"
    # Long enough that it goes on when it is told to stop.
    line = shlex.join(["synthetic:frames=2000,width=96,height=72", *SMALL])
    name = "synthetic-frames-2000-width-96-height-72"
    (tmp_path / "list.txt").write_text(f"{line}\n{line}\n")

    def interrupt():
        end = time.monotonic() + 120
        while not (out / name / "config.json").exists() and time.monotonic() < end:
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGTERM)

    thread = threading.Thread(target=interrupt)
    thread.start()
    command = ["batch", str(tmp_path / "list.txt"), "--out", str(out), "--scheduler", scheduler]
    assert main([*command, "--jobs", "1"]) == 130
    thread.join()
    assert "Interrupted; the same command goes on." in capsys.readouterr().err
    # The second one was not begun.
    (row,) = read_record(out / "batch.csv").values()
    assert (row.name, row.state) == (name, "interrupted"), row.message


def test_a_worker_without_the_batchs_files_says_so(words, scheduler, tmp_path, monkeypatch, capsys):
    (tmp_path / "list.txt").write_text(shlex.join(words))
    out, elsewhere = tmp_path / "out", tmp_path / "not on the worker"
    # The batch's folder, as a worker on a machine without it is told.
    monkeypatch.setattr(Path, "cwd", lambda: elsewhere)
    command = ["batch", str(tmp_path / "list.txt"), "--out", str(out), "--scheduler", scheduler]
    assert main(command) == 1
    (row,) = read_record(out / "batch.csv").values()
    assert row.state == "failed"
    assert f"does not see {out} and {elsewhere}: a cluster needs a file system" in row.message
    assert row.message in capsys.readouterr().out


def test_a_scheduler_that_is_not_there_gets_one_sentence(words, tmp_path, capsys):
    (tmp_path / "list.txt").write_text(shlex.join(words))
    for address in ("tcp://127.0.0.1:9", "nowhere"):
        command = ["batch", str(tmp_path / "list.txt"), "--out", str(tmp_path / "out")]
        with dask.config.set({"distributed.comm.timeouts.connect": 1}):
            assert main([*command, "--scheduler", address]) == 2
        assert capsys.readouterr().err == f"sfgs-jax: No Dask scheduler answers at '{address}'.\n"
        assert not (tmp_path / "out").exists()


def test_a_scheduler_without_workers_is_named(words, tmp_path, capsys):
    (tmp_path / "list.txt").write_text(shlex.join(words))
    cluster = local_cluster(0)
    address = cluster.scheduler_address
    with dask.config.set({"distributed.comm.timeouts.connect": 1}):
        assert main(["batch", str(tmp_path / "list.txt"), "--scheduler", address]) == 2
    cluster.close()
    assert capsys.readouterr().err == f"sfgs-jax: The scheduler at {address} has no workers.\n"
