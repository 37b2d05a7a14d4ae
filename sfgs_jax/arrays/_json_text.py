"""JSON that somebody else wrote."""

import json
from typing import Any

from sfgs_jax.arrays._excerpts import excerpt


def parsed_json(text: str | bytes) -> Any:
    """The value that a text in JSON stands for.

    Args:
        text: the content of a file.

    Raises:
        ValueError: it is no JSON, has too many levels, or an object has two entries of one name, of which
            nobody can tell the right one.
    """
    try:
        return json.loads(text, object_pairs_hook=_object)
    except RecursionError as error:
        raise ValueError(excerpt(error)) from error


def _object(entries: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(entries)
    if len(found) < len(entries):
        names = [name for name, _ in entries]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"it has two entries {excerpt(twice)}")
    return found
