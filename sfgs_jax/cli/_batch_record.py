"""Outcomes of a batch: batch.csv, from which a batch goes on, and the table at the end."""

import csv
import io
import math
import shlex
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Literal, get_args

from sfgs_jax.arrays import InputError, excerpt, file_text, parsed_json, write_atomically
from sfgs_jax.cli._batch_list import Entry

RECORD_FILE = "batch.csv"
"""Name of the file in the output folder."""

State = Literal["done", "failed", "interrupted", "running"]


@dataclass(frozen=True)
class Outcome:
    """A row of batch.csv.

    Attributes:
        name: folder of the run in the output folder.
        words: source and options, quoted for a shell.
        state: "running" is left behind by a batch that was killed.
        frames: of the recording; 0 if the run did not come to count them.
        tracked: frames with a pose.
        ate_m: RMSE of the absolute trajectory error, metres; NaN where there is none.
        psnr_db: over all frames and pixels, dB; NaN where there is none.
        seconds: from start to end of the process, those of interrupted runs before included.
        message: a sentence on why it failed; empty if it did not.
    """

    name: str
    words: str
    state: State
    frames: int = 0
    tracked: int = 0
    ate_m: float = math.nan
    psnr_db: float = math.nan
    seconds: float = 0.0
    message: str = ""


def outcome_of(entry: Entry, folder: Path, state: State, seconds: float, message: str) -> Outcome:
    """The outcome of a run that has ended, with the figures in its folder.

    Args:
        entry: the recording.
        folder: of the run.
        state: how it ended.
        seconds: that it took.
        message: why it failed.
    """
    try:
        metrics = parsed_json(file_text(folder / "metrics.json"))
    except (OSError, ValueError):
        metrics = {}
    frames = metrics.get("frames", {})
    return Outcome(
        entry.name,
        shlex.join(entry.words),
        state,
        frames.get("total", 0),
        frames.get("tracked", 0),
        metrics.get("ate", {}).get("rmse_m", math.nan),
        metrics.get("psnr", {}).get("all", math.nan),
        round(seconds, 1),
        message,
    )


def write_record(path: Path, outcomes: list[Outcome]) -> None:
    """Write batch.csv; figures that there are none of stay empty.

    Args:
        path: of the file.
        outcomes: its rows.

    Raises:
        OSError: it can't be written.
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, [field.name for field in fields(Outcome)], lineterminator="\n")
    writer.writeheader()
    for outcome in outcomes:
        writer.writerow({name: "" if value != value else value for name, value in asdict(outcome).items()})
    write_atomically(path, text.getvalue())


def read_record(path: Path) -> dict[str, Outcome]:
    """The rows of batch.csv by name; none if there is no file.

    Args:
        path: of the file.

    Raises:
        InputError: it is not such a file.
    """
    if not path.exists():
        return {}
    try:
        rows = [_outcome(row) for row in csv.DictReader(io.StringIO(file_text(path)))]
    except (OSError, ValueError, KeyError, TypeError, csv.Error) as error:
        raise InputError(
            f"{path} is no record of a batch ({excerpt(error)}): remove it, or choose another folder with "
            "--out."
        ) from error
    return {outcome.name: outcome for outcome in rows}


def _outcome(row: dict[str, str]) -> Outcome:
    if row["state"] not in get_args(State):
        raise ValueError(f"there is no state {row['state']!r}")
    numbers = {name: float(row[name] or math.nan) for name in ("ate_m", "psnr_db", "seconds")}
    counts = {name: int(row[name]) for name in ("frames", "tracked")}
    words = {name: row[name] for name in ("name", "words", "state", "message")}
    return Outcome(**words, **counts, **numbers)  # pyright: ignore[reportArgumentType]


def batch_table(outcomes: list[Outcome]) -> str:
    """The table that a batch ends with, and a line on each failure.

    Args:
        outcomes: of all recordings.
    """
    rows = [("recording", "state", "tracked", "ATE cm", "PSNR dB", "seconds")]
    rows += [
        (
            outcome.name,
            outcome.state,
            f"{outcome.tracked} of {outcome.frames}" if outcome.frames else "-",
            _number(100 * outcome.ate_m, 2),
            _number(outcome.psnr_db, 2),
            _number(outcome.seconds, 0),
        )
        for outcome in outcomes
    ]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    # Words to the left, numbers to the right.
    form = "  ".join(f"{{:{'<' if i < 2 else '>'}{width}}}" for i, width in enumerate(widths))
    lines = [form.format(*row) for row in rows]
    return "\n".join([*lines, *(f"{o.name}: {o.message}" for o in outcomes if o.message)])


def _number(value: float, digits: int) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f}"
