"""Finding images in folders."""

import re
from pathlib import Path


def images_in(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    """Visible files of a folder with one of these suffixes, in natural order (2 before 10)."""
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
        (0, int(part)) if part.isdecimal() else (1, part) for part in re.split(r"(\d+)", name) if part
    )


def by_number(folder: Path, prefix: str, suffixes: tuple[str, ...]) -> dict[int, Path]:
    """Images of a folder whose names are `prefix` and a frame number, by that number."""
    found = {}
    for path in images_in(folder, suffixes):
        match = re.fullmatch(re.escape(prefix) + r"(\d+)", path.stem)
        if match:
            found[int(match[1])] = path
    return found
