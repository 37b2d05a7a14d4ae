"""Images in a folder, in natural order or by frame number, and pairs of them."""

import re
from pathlib import Path

from sfgs_jax.arrays import InputError

_MOST_DIGITS = 255
"""No name of a file is longer, but a list may hold anything, and Python reads no number of 5000 digits."""


def images_in(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    """Visible files of a folder, in natural order (2 before 10).

    Args:
        folder: the folder; one that does not exist holds no images.
        suffixes: endings of the wanted files, in lower case, such as `COLOUR_SUFFIXES`.
    """
    if not folder.is_dir():
        return []
    found = [
        path
        for path in folder.iterdir()
        if path.suffix.lower() in suffixes and not path.name.startswith(".") and path.is_file()
    ]
    return sorted(found, key=lambda path: natural_key(path.name))


def natural_key(name: str) -> tuple[tuple[int, int | str], ...]:
    """Sort key that takes runs of digits as numbers."""
    return tuple(
        (0, int(part)) if part.isdecimal() and len(part) <= _MOST_DIGITS else (1, part)
        for part in re.split(r"(\d+)", name)
        if part
    )


def images_by_number(folder: Path, prefix: str, suffixes: tuple[str, ...]) -> dict[int, Path]:
    """Images whose names are a prefix and a frame number.

    Args:
        folder: the folder.
        prefix: text before the number; may be empty.
        suffixes: endings, as in `images_in`.

    Returns:
        Paths by frame number.
    """
    found = {}
    for path in images_in(folder, suffixes):
        match = re.fullmatch(re.escape(prefix) + r"(\d+)", path.stem)
        if match:
            found[int(match[1])] = path
    return found


def matched_images(
    source: Path, colour: list[Path], depth: list[Path]
) -> tuple[list[tuple[Path, Path]], list[str]]:
    """Colour and depth images that belong together, and notes for the log.

    They are matched by name, or in natural order if there are equally many but the names differ.

    Args:
        source: the recording, for messages.
        colour: files in natural order.
        depth: files in natural order.

    Raises:
        InputError: no two images belong together.
    """
    by_stem = {path.stem: path for path in depth}
    common = [path for path in colour if path.stem in by_stem]
    if len(colour) == len(depth) and len(common) < len(colour):
        return list(zip(colour, depth, strict=True)), []
    if not common:
        raise InputError(
            f"{source} has {len(colour)} colour and {len(depth)} depth images, and no two share a name; "
            "give images that belong together the same name."
        )
    unmatched = len(colour) - len(common)
    notes = (
        [f"{unmatched} of {len(colour)} colour images have no depth image of that name."] if unmatched else []
    )
    return [(path, by_stem[path.stem]) for path in common], notes
