"""Saving that fails, or damage to what was saved: the state before or after is found, or none."""

import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from random import Random

import jax
import numpy as np

from experiments.crash_faults import CALLS, Faults
from experiments.crash_power_loss import RecordedDisk
from sfgs_jax import slam
from sfgs_jax.arrays import InputError

_PAGE = 4096


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
