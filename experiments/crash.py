"""Crashes of a small run: each leaves the state before or after it, and the run ends in the same files.

`python -m experiments.crash --kills 200` runs all parts and exits with 1 if one of them finds a defect:

- every call of `open`, `write`, `fsync` and `replace` that saving makes fails, once and from then on;
- the power is lost at every change of the disk, and with it whatever was not forced there;
- every file of a saved state is cut at every 4 KiB, and bits of it are flipped;
- runs are killed at random instants of their CPU time, and taken up again until they end.
"""

import argparse
import resource
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from random import Random

import jax
import numpy as np

from experiments.crash_faults import CALLS, Faults
from experiments.crash_power_loss import RecordedDisk
from sfgs_jax import slam
from sfgs_jax.arrays import InputError, enable_cache
from sfgs_jax.datasets import SyntheticRecording

SAME_FILES = ("trajectory.txt", "trajectory_covariance.txt", "keyframes.txt", "map.ply", "config.json")
_PAGE = 4096
_SOURCE = "synthetic:frames=12,width=80,height=60"
_SETTINGS = (
    "--mapping.capacity=8192", "--mapping.pair-capacity=32768", "--mapping.final-steps=12",
    "--mapping.views-in-memory=1", "--tracking.gicp.levels=1", "--checkpoint-interval=3", "--quiet",
)  # fmt: skip


def same_state(a: slam.Run, b: slam.Run) -> bool:
    """True if two runs are at the same point with the same numbers, to the bit."""
    left, right = jax.tree.leaves(a.state), jax.tree.leaves(b.state)
    counts = [(r.num_frames, r.num_skipped, r.num_refined, r.is_finished) for r in (a, b)]
    return (
        counts[0] == counts[1]
        and len(left) == len(right)
        and all(np.array_equal(x, y) for x, y in zip(left, right, strict=True))
    )


def failing_saves(
    before: slam.Run, after: slam.Run, folder: Path, *, every: int = 1
) -> Iterator[tuple[str, str]]:
    """Outcomes of saving `after` over `before` while the n-th call of a kind fails, for every n.

    Args:
        before: the run that is on disk.
        after: the run that is saved.
        folder: for the states.
        every: difference between one n and the next.

    Yields:
        What failed, and "before" or "after" for the state that is on disk then; anything else is a defect.
    """
    slam.save_run(before, folder / "before")
    for call in CALLS:
        for for_ever in (False, True):
            n, failed = 1, True
            while failed:
                place = folder / "now"
                shutil.rmtree(place, ignore_errors=True)
                shutil.copytree(folder / "before", place)
                with Faults(call, n, for_ever=for_ever) as faults:
                    told = _failure(lambda: slam.save_run(after, place))  # noqa: B023
                failed = faults.failed
                if failed:
                    what = f"{call} {n}{' and later' if for_ever else ''}"
                    yield what, told or _state_of(place, before, after)
                    slam.save_run(after, place)
                    yield f"{what}, saved again", _state_of(place, before, after)
                n += every


def _failure(save: Callable[[], None]) -> str:
    """The error of a save that is no OSError."""
    try:
        save()
    except OSError:
        return ""
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return ""


def _state_of(folder: Path, before: slam.Run, after: slam.Run) -> str:
    try:
        found = slam.load_run(folder, before.config)
    except InputError as error:
        return str(error)
    if same_state(found, after):
        return "after"
    return "before" if same_state(found, before) else "between"


def lost_writes(
    runs: Sequence[slam.Run], folder: Path, *, seed: int, count: int
) -> Iterator[tuple[str, str]]:
    """Outcomes of a loss of power at every change of the disk, while runs are saved one after the other.

    Args:
        runs: points of one run, in their order.
        folder: for the states.
        seed: of the choices of what is lost.
        count: of these choices at each change, besides three that are always made.

    Yields:
        The change, and "before" or "after" for the state that is found, or "saved" for the newest that a save
        has ended with. Anything else is a defect.
    """
    place, after_loss, ends = folder / "recorded", folder / "found", [0]
    place.mkdir()
    with RecordedDisk(place) as disk:
        for run in runs:
            slam.save_run(run, place / slam.STORAGE)
            ends.append(len(disk))
    random, known = Random(seed), dict[frozenset, int]()
    for at in range(ends[-1] + 1):
        done = sum(end <= at for end in ends) - 1
        for files in disk.losses(at, random, count=count):
            read = frozenset(item for item in files.items() if not item[0].name.startswith("."))
            if read not in known:
                _write(files, after_loss)
                known[read] = _found(after_loss / slam.STORAGE, runs)
            found = known[read]
            names = {done: "saved" if at == ends[done] else "before", done + 1: "after"}
            yield f"change {at} of {ends}", names.get(found, f"state {found}")


def _found(storage: Path, runs: Sequence[slam.Run]) -> int:
    """Number of the run that is on disk, 0 for none, -1 for damage; the newest can be saved there."""
    try:
        loaded = slam.load_run(storage, runs[0].config)
        found = next((i for i, run in enumerate(runs, 1) if same_state(loaded, run)), -1)
    except InputError as error:
        found = 0 if "holds no checkpoint" in str(error) else -1
    slam.save_run(runs[-1], storage)
    return found if _state_of(storage, runs[0], runs[-1]) == "after" else -1


def _write(files: dict[Path, bytes], folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    for path, content in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(content)


def damaged_states(
    run: slam.Run, folder: Path, *, flips: int, seed: int, every: int = _PAGE
) -> Iterator[tuple[str, str]]:
    """Outcomes of loading a state of which one file is cut off or has a flipped bit.

    Args:
        run: the run to save.
        folder: for the state.
        flips: flipped bits in each file.
        seed: of the bits.
        every: bytes between two places to cut at.

    Yields:
        The damage, and "refused" if it was refused in one sentence; anything else is a defect.
    """
    slam.save_run(run, folder)
    random = Random(seed)
    for path in sorted(folder.iterdir()):
        content = path.read_bytes()
        cuts = {f"{path.name} cut at {n}": content[:n] for n in range(0, len(content), every)}
        bits = [random.randrange(8 * len(content)) for _ in range(flips)]
        flipped = {f"{path.name} bit {bit}": _flipped(content, bit) for bit in bits}
        for name, damaged in (cuts | flipped).items():
            path.write_bytes(damaged)
            yield name, _refusal(folder, run)
        path.write_bytes(content)
    yield "undamaged", "refused" if _state_of(folder, run, run) == "after" else "not loaded"


def _flipped(content: bytes, bit: int) -> bytes:
    changed = bytearray(content)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


def _refusal(folder: Path, run: slam.Run) -> str:
    try:
        slam.load_run(folder, run.config)
    except InputError as error:
        return "refused" if "\n" not in str(error) else "many lines"
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return "accepted"


def killed_runs(kills: int, folder: Path, seed: int) -> Iterator[tuple[str, str]]:
    """Outcomes of runs that are killed at random instants of CPU time, each taken up again until it ends.

    Args:
        kills: number of kills.
        folder: for the runs.
        seed: of the instants.

    Yields:
        The run, and "same files" if these are as without a kill; anything else is a defect.
    """
    random = Random(seed)
    _command(folder / "whole")
    _, seconds = _command(folder / "whole", "--overwrite")
    done = 0
    while done < kills:
        out, words, before = folder / "killed", ["--overwrite"], done
        while done < kills:
            # Limits are of whole seconds, so the instant is set by a timer of CPU time in the child.
            status, _ = _command(out, *words, cpu_s=random.uniform(0.05, 1.1) * seconds)
            if status >= 0:
                break
            done += 1
            words = ["--resume"] if (out / slam.STORAGE / "state.safetensors").exists() else ["--overwrite"]
            if _is_whole(out) and words == ["--overwrite"]:
                break
        else:
            status, _ = _command(out, *words)
        different = [name for name in SAME_FILES if not _equal(out / name, folder / "whole" / name)]
        same = "same files" if not different and _is_whole(out) else f"status {status}, other {different}"
        yield f"run of {done - before} kills", same


def _is_whole(out: Path) -> bool:
    return (out / "report.html").exists()


def _equal(a: Path, b: Path) -> bool:
    return a.exists() and a.read_bytes() == b.read_bytes()


def _command(out: Path, *words: str, cpu_s: float = 0.0) -> tuple[int, float]:
    """Status and CPU seconds of `sfgs-jax run`, which is killed after `cpu_s` of them, if given."""
    # Nobody handles the timer's signal, so it ends the process at once, within any instruction.
    code = (
        "import signal, sys; from sfgs_jax.cli import main; "
        "signal.signal(signal.SIGPROF, signal.SIG_DFL); "
        f"signal.setitimer(signal.ITIMER_PROF, {cpu_s}); sys.exit(main(sys.argv[1:]))"
    )
    start = resource.getrusage(resource.RUSAGE_CHILDREN)
    arguments = ["run", _SOURCE, "--out", str(out), *_SETTINGS, *words]
    done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True)
    end = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode > 0 or "Traceback" in done.stderr:
        print(done.stderr[-2000:], file=sys.stderr)
    return done.returncode, end.ru_utime + end.ru_stime - start.ru_utime - start.ru_stime


def _two_points() -> tuple[slam.Run, slam.Run]:
    """A small run at a frame, and at its end."""
    recording = SyntheticRecording(num_frames=6, width=80, height=60)
    preset = slam.PRESETS["synthetic"]
    config = replace(
        preset,
        tracking=replace(
            preset.tracking,
            gicp=replace(preset.tracking.gicp, levels=1, strides=(1,)),
            keyframe_translation=0.03,
        ),
        mapping=replace(preset.mapping, capacity=8192, pair_capacity=32768, final_steps=2, view_interval=2),
    )
    frames = [(i, recording[i]) for i in range(len(recording))]
    before = slam.run(frames[:3], recording.camera, config)
    return before, slam.run(frames, recording.camera, config)


def _report(title: str, outcomes: Iterator[tuple[str, str]], held: tuple[str, ...]) -> int:
    """Print how often each outcome occurred and all defects; returns the number of defects."""
    counts: Counter[str] = Counter()
    for what, outcome in outcomes:
        counts[outcome if outcome in held else "defect"] += 1
        if outcome not in held:
            print(f"{title}: {what}: {outcome}")
    print(f"{title}: {sum(counts.values())}, " + ", ".join(f"{n} {name}" for name, n in counts.items()))
    return counts["defect"]


def main() -> int:
    """Run the experiment."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--flips", type=int, default=20, help="flipped bits in each file")
    parser.add_argument("--losses", type=int, default=8, help="random losses at each change of the disk")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    enable_cache()
    before, after = _two_points()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        damages = damaged_states(after, folder / "state", flips=options.flips, seed=options.seed)
        defects = _report("failing calls", failing_saves(before, after, folder), ("before", "after"))
        power = lost_writes((before, after), folder, seed=options.seed, count=options.losses)
        defects += _report("losses of power", power, ("before", "after", "saved"))
        defects += _report("damaged files", damages, ("refused",))
        if options.kills:
            runs = killed_runs(options.kills, folder, options.seed)
            defects += _report(f"runs with {options.kills} kills in all", runs, ("same files",))
    return 1 if defects else 0


if __name__ == "__main__":
    sys.exit(main())
