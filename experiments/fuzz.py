"""Damaged files of every format: each is refused in one sentence, or read as something that makes sense.

`python -m experiments.fuzz --inputs 2000` damages stand-ins of every format and counts what became of them.
The same seed gives the same inputs.
"""

import argparse
import resource
import signal
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from random import Random

from experiments.fuzz_formats import Format, Garbage, formats
from experiments.fuzz_mutations import mutated
from sfgs_jax.arrays import InputError

OUTCOMES = ("ok", "refused", "traceback", "over-long", "garbage", "hang", "memory")
"""Fates of an input; the last five are defects."""

LONGEST_MESSAGE = 600
LONGEST_SECONDS = 20
_MOST_LINES = 40
MEMORY_BYTES = 3 << 30
"""Address space that a loader may add to that of the process."""


class Hang(Exception):
    """A loader takes longer than `LONGEST_SECONDS`."""


def outcome(kind: Format, folder: Path) -> tuple[str, str]:
    """The fate of the files in a folder, and a line about it.

    Args:
        kind: the format of the files.
        folder: where they are.
    """
    try:
        with _limited(), warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            kind.load(folder)
    except Garbage as error:
        return "garbage", str(error)
    except InputError as error:
        text = str(error)
        is_long = len(text) - text.count(str(folder)) * len(str(folder)) > LONGEST_MESSAGE or "\n" in text
        return ("over-long" if is_long else "refused"), text[:200]
    except MemoryError:
        return "memory", traceback.format_exc(limit=-1)
    except Hang:
        return "hang", traceback.format_exc(limit=-1)
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)
        ours = [frame for frame in place if "sfgs_jax" in frame.filename]
        where = f"{Path(ours[-1].filename).name}:{ours[-1].lineno}" if ours else "?"
        return "traceback", f"{type(error).__name__} at {where}: {str(error)[:120]!r}"
    return "ok", ""


def fuzzed(name: str, kind: Format, inputs: int, seed: int) -> Iterator[tuple[str, str, str, bytes]]:
    """Outcomes of damaged inputs, each with its line, the file that was damaged and its content.

    Args:
        name: of the format; inputs of one format do not depend on the others.
        kind: the format.
        inputs: number of inputs.
        seed: of the damages.
    """
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "files"
        for path, content in kind.files.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(content)
        found, line = outcome(kind, folder)
        if found != "ok":
            raise RuntimeError(f"{name} is {found} before any damage: {line}")
        for i in range(inputs):
            random = Random(f"{seed} {name} {i}")
            target = random.choice(kind.targets)
            content = mutated(kind.files[target], random)
            (folder / target).write_bytes(content)
            yield *outcome(kind, folder), target, content
            (folder / target).write_bytes(kind.files[target])


def limit_memory() -> None:
    """Let loaders fail that ask for gigabytes."""
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY_BYTES, resource.RLIM_INFINITY))


@contextmanager
def _limited() -> Iterator[None]:
    def stop(*_: object) -> None:
        raise Hang

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, LONGEST_SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def main() -> None:
    """Print the table; defects are listed below it."""
    parser = argparse.ArgumentParser(description="Damaged files of every format, and what becomes of them.")
    parser.add_argument("names", nargs="*", help="formats; all without any")
    parser.add_argument("--inputs", type=int, default=2000, help="damaged inputs of each format")
    parser.add_argument("--seed", type=int, default=0, help="of the damages")
    parser.add_argument("--keep", type=Path, help="folder for the inputs that showed a defect")
    arguments = parser.parse_args()
    known = formats()
    if unknown := set(arguments.names) - known.keys():
        parser.error(f"no format {sorted(unknown)[0]!r}; there are {', '.join(known)}")
    limit_memory()
    print(f"| format | inputs | {' | '.join(OUTCOMES)} | slowest s |")
    print("|" + "---|" * (len(OUTCOMES) + 3))
    defects: Counter[tuple[str, str, str]] = Counter()
    for name in arguments.names or known:
        counts: Counter[str] = Counter()
        slowest, start = 0.0, time.perf_counter()
        for i, (found, line, target, content) in enumerate(
            fuzzed(name, known[name], arguments.inputs, arguments.seed)
        ):
            slowest, start = max(slowest, time.perf_counter() - start), time.perf_counter()
            counts[found] += 1
            if found not in ("ok", "refused"):
                defects[name, found, line] += 1
                if arguments.keep is not None:
                    arguments.keep.mkdir(parents=True, exist_ok=True)
                    (arguments.keep / f"{name}-{i}-{Path(target).name}").write_bytes(content)
        numbers = " | ".join(str(counts[found]) for found in OUTCOMES)
        print(f"| {name} | {arguments.inputs} | {numbers} | {slowest:.1f} |", flush=True)
    for (name, found, line), count in defects.most_common(_MOST_LINES):
        print(f"{count} x {name}: {found}: {line[:160]}")


if __name__ == "__main__":
    main()
