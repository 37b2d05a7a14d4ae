"""`config.json`: everything needed to run again."""

import dataclasses
import json
import types
import typing
from pathlib import Path
from typing import Any, TypeVar

from sfgs_jax.arrays import InputError, excerpt, file_text, parsed_json
from sfgs_jax.datasets import ReaderOptions
from sfgs_jax.slam import SlamConfig

_T = TypeVar("_T")


@dataclasses.dataclass(frozen=True)
class RunConfig:
    """Source and settings of a run."""

    source: str
    """Recording, as given on the command line; a path is made absolute."""
    dataset: str
    """Layout of the recording."""
    reader: ReaderOptions
    """Settings of the reader."""
    slam: SlamConfig
    """Settings of the system."""
    sensors: Path | None = None
    """The sensors.json that it began with."""
    map: Path | None = None
    """Folder of the run whose map it went on in."""


def to_json(config: RunConfig) -> str:
    """The configuration as JSON text."""
    return json.dumps(dataclasses.asdict(config), indent=2, default=str) + "\n"


def from_json(text: str, name: str) -> RunConfig:
    """The configuration that JSON text holds.

    Args:
        text: the file's text.
        name: the file's name, for messages.

    Raises:
        InputError: it is not JSON, or a setting is missing, unknown, of the wrong kind or out of range.
    """
    try:
        data = parsed_json(text)
    except ValueError as error:
        raise InputError(f"{name} is not JSON ({excerpt(error)}).") from error
    return _build(RunConfig, data, name)


def read_config(path: Path) -> RunConfig:
    """The configuration in a file. Raises InputError as `from_json` does, or if the file can't be read."""
    try:
        text = file_text(path)
    except (OSError, ValueError) as error:
        raise InputError(f"Cannot read the configuration {path}: {excerpt(error)}.") from error
    return from_json(text, str(path))


def _build(kind: type[_T], data: Any, name: str) -> _T:
    """A dataclass from the dictionary that `dataclasses.asdict` made of one."""
    if not isinstance(data, dict):
        raise InputError(f"{name} must hold settings by name, not {excerpt(data)}.")
    hints = typing.get_type_hints(kind)
    known = {field.name for field in dataclasses.fields(typing.cast(Any, kind))}
    unknown = sorted(set(data) - known)
    if unknown:
        raise InputError(f"{name} has a setting {excerpt(unknown[0])} that this version does not know.")
    values = {key: _convert(hints[key], value, f"{name}: {key}") for key, value in data.items()}
    try:
        return kind(**values)
    except TypeError as error:
        raise InputError(f"{name} lacks a setting ({excerpt(error)}).") from error
    except InputError as error:
        raise InputError(f"{name}: {error}") from error


def _float(value: float | int, name: str) -> float:
    try:
        return float(value)
    except OverflowError:
        raise InputError(f"{name} cannot be {excerpt(value)}.") from None


def _convert(hint: Any, value: Any, name: str) -> Any:
    if dataclasses.is_dataclass(hint):
        return _build(typing.cast(type, hint), value, name)
    options = typing.get_args(hint) if typing.get_origin(hint) in (typing.Union, types.UnionType) else (hint,)
    for option in options:
        if option is type(None) and value is None:
            return None
        if typing.get_origin(option) is typing.Literal and value in typing.get_args(option):
            return value
        if typing.get_origin(option) is tuple and isinstance(value, list):
            return tuple(_convert(typing.get_args(option)[0], item, name) for item in value)
        if option is Path and isinstance(value, str):
            return Path(value)
        if option is float and isinstance(value, int | float) and not isinstance(value, bool):
            return _float(value, name)
        if isinstance(option, type) and type(value) is option:
            return value
    raise InputError(f"{name} cannot be {excerpt(value)}.")
