"""Runs that are killed at random instants of their CPU time, and taken up again until they end."""

import inspect
import re
import resource
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from random import Random

from experiments.crash_outputs import other_files
from sfgs_jax import slam
from sfgs_jax.slam.run import STATE_FILE

_SOURCE = "synthetic:frames=48,width=80,height=60"
_SETTINGS = (
    "--mapping.capacity=8192", "--mapping.pair-capacity=32768", "--mapping.final-steps=40",
    "--mapping.views-in-memory=1", "--tracking.gicp.levels=1", "--checkpoint-interval=1", "--quiet",
)  # fmt: skip
_STAGES = {
    "checkpoint": "save_run",
    "evaluation": "evaluate_folder",
    "outputs": "write_run",
    "refinement": "refine_once",
    "mapping": "learn",
    "tracking": "follow",
    "start": "main",
}
"""A function that runs in each stage only; the first that is found counts."""
_COMPILER = re.compile(
    r"jax/_src/(interpreters/(partial_eval|mlir)|compiler|compilation_cache|pjit)\.py.* in (?!call)"
)
_PROGRAM = """
import faulthandler, signal, sys
from sfgs_jax import slam
from sfgs_jax.cli import main
# Programs are compiled in the stage that needs them, so that most instants fall into the stages.
sys.modules[{driver!r}].warm_up = lambda camera, config: None
# The signal ends the process at once, within any instruction, after it was written down where it was.
faulthandler.register(signal.SIGPROF, file=open({trace!r}, "w"), chain=True)
signal.setitimer(signal.ITIMER_PROF, {cpu_s})
sys.exit(main(sys.argv[1:]))
"""


def killed_runs(kills: int, folder: Path, seed: int) -> Iterator[tuple[list[str], str]]:
    """Outcomes of runs that are killed at random instants of CPU time, each taken up again until it ends.

    Args:
        kills: number of kills.
        folder: for the runs.
        seed: of the instants.

    Yields:
        The stages in which it was killed; and "same files" if the run has ended in those of a run without a
        kill, anything else is a defect.
    """
    random = Random(seed)
    whole, trace = folder / "whole", folder / "trace.txt"
    _command(whole, trace, "--overwrite")
    _, seconds = _command(whole, trace, "--overwrite")
    done = 0
    while done < kills:
        out, words, stages = folder / "killed", ["--overwrite"], list[str]()
        while done < kills:
            # Half of the instants come early: what follows the last frame takes most of the time.
            latest = random.choice((0.5, 1.0))
            status, _ = _command(out, trace, *words, cpu_s=random.uniform(0.1, latest) * seconds)
            if status >= 0:
                break
            done += 1
            stages.append(_stage(trace.read_text()))
            words = ["--resume"] if (out / slam.STORAGE / STATE_FILE).exists() else ["--overwrite"]
            if _is_whole(out) and words == ["--overwrite"]:
                break
        else:
            status, _ = _command(out, trace, *words)
        different = other_files(out, whole)
        same = not different and _is_whole(out) and not any((out / slam.STORAGE).glob("*"))
        yield stages, "same files" if same else f"status {status}, other {different}"


def _stage(trace: str) -> str:
    """Stage of a run by the stack of its threads."""
    names = re.findall(r" in (\S+)$", trace, re.MULTILINE)
    found = next((stage for stage, function in _STAGES.items() if function in names), "imports")
    return f"{found}, compiling" if _COMPILER.search(trace) else found


def _is_whole(out: Path) -> bool:
    return (out / "report.html").exists()


def _command(out: Path, trace: Path, *words: str, cpu_s: float = 0.0) -> tuple[int, float]:
    """Status and CPU seconds of `sfgs-jax run`, which is killed after `cpu_s` of them, if given."""
    driver = getattr(inspect.getmodule(slam.run), "__name__", "")
    code = _PROGRAM.format(driver=driver, trace=str(trace), cpu_s=cpu_s)
    start = resource.getrusage(resource.RUSAGE_CHILDREN)
    arguments = ["run", _SOURCE, "--out", str(out), *_SETTINGS, *words]
    done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True)
    end = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode > 0 or "Traceback" in done.stderr:
        print(done.stderr[-2000:], file=sys.stderr)
    return done.returncode, end.ru_utime + end.ru_stime - start.ru_utime - start.ru_stime
