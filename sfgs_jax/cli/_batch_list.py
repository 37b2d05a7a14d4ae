"""The list of a batch: a text file with a recording in each line, and options of its run after it."""

import contextlib
import io
import re
import shlex
from dataclasses import dataclass
from pathlib import Path

from sfgs_jax.arrays import InputError, excerpt, file_text
from sfgs_jax.cli._run import RunOptions, parse_run

_OF_THE_BATCH = ("out", "overwrite", "resume", "quiet", "view", "realtime")
"""Options that the batch decides itself, or that make no sense for runs side by side."""


@dataclass(frozen=True)
class Entry:
    """A recording of a batch.

    Attributes:
        line: its number in the list, from 1.
        name: its folder in the output folder, different for each line.
        words: source and options, as `sfgs-jax run` takes them.
    """

    line: int
    name: str
    words: tuple[str, ...]


def read_list(path: Path) -> list[Entry]:
    """The recordings of a list.

    A line is a source and options of `sfgs-jax run`, in the quotes of a shell where needed. Empty lines are
    left out, and so is everything behind `#`.

    Args:
        path: of the text file.

    Raises:
        InputError: it can't be read, has no recording, or a line is not understood; the line is named.
    """
    try:
        text = file_text(path)
    except (OSError, ValueError) as error:
        raise InputError(f"Cannot read the list {path}: {excerpt(error)}.") from error
    entries: list[Entry] = []
    for number, line in enumerate(text.splitlines(), start=1):
        try:
            words = shlex.split(line, comments=True)
            if not words:
                continue
            _check(words)
        except (InputError, ValueError) as error:
            reason = str(error) if isinstance(error, InputError) else f"{excerpt(error)}."
            raise InputError(f"{path}, line {number}: {reason}") from error
        entries.append(Entry(number, _name(words[0], entries), tuple(words)))
    if not entries:
        raise InputError(f"The list {path} names no recording: write one in each line.")
    return entries


def _check(words: list[str]) -> None:
    """Refuse options that a run does not have, or that are not a line's to decide."""
    if words[0].startswith("-"):
        raise InputError(f"A line begins with a recording, not with the option {excerpt(words[0])}.")
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            _, options = parse_run(words, RunOptions())
    except SystemExit as stop:
        raise InputError(f"{_reason(said.getvalue()) if stop.code else 'It asks for help'}.") from None
    default = RunOptions()
    for name in _OF_THE_BATCH:
        if getattr(options, name) != getattr(default, name):
            raise InputError(f"--{name} is no option of one recording in a batch.")


def _reason(shown: str) -> str:
    """The sentence in the frame of a message about options."""
    parts = re.split(r"\n\W*[-─]{4,}\W*\n", shown)
    words = re.sub(r"[│╭╮╰╯─]", " ", parts[1] if len(parts) > 1 else shown).split()
    return " ".join(words).rstrip(".")


def _name(source: str, before: list[Entry]) -> str:
    """A folder's name for a source; one that is taken gets a number."""
    stem = Path(source).name if Path(source).name else source
    name = plain = re.sub(r"[^\w.-]+", "-", stem).strip("-.") or "recording"
    taken, count = {entry.name for entry in before}, 1
    while name in taken:
        count += 1
        name = f"{plain}-{count}"
    return name
