"""Kinds of arguments, as annotations name them: arrays, numbers, words, paths, and objects of a class."""

import inspect
import types
import typing
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from pathlib import Path
from typing import Any

import jax
import numpy as np

from sfgs_jax.arrays._arguments import is_array
from sfgs_jax.arrays._input_files import can_be_path

_NUMBERS = {"f": "floating-point numbers", "i": "integers", "b": "booleans", "c": "complex numbers"}
"""Words for kinds of numbers, by NumPy's letters."""

_LOOKED_AT = 16
"""Entries of a sequence that are checked."""

Sizes = dict[str, Any]
"""Sizes of a call's arrays by the names that annotations give them."""


@dataclass(frozen=True)
class Kind:
    """What an argument should be.

    Attributes:
        text: words for it, behind "should be".
        fits: whether a value is such a thing; takes and notes the sizes of the call.
        names: of the sizes in the shape of an array.
    """

    text: str
    fits: Callable[[Any, Sizes], bool]
    names: tuple[str, ...] = ()


def kind_of(hint: Any) -> Kind | None:
    """What an annotation asks for; None if it can't be told, and then the argument is not checked.

    Args:
        hint: the annotation.
    """
    origin, options = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        # Text that stands for a path is checked as one.
        either = [
            _PATH if option in (Path, str) and {Path, str} <= {*options} else kind_of(option)
            for option in options
        ]
        return _any_of(either)
    if origin in (tuple, Sequence):
        return _series(origin, options)
    if origin is typing.Literal:
        text = f"one of {', '.join(map(repr, options))}"
        return Kind(text, lambda value, _: _is_word(value) and value in options)
    if hasattr(hint, "dim_str") and hasattr(hint, "dtypes"):
        return _array(hint.dim_str, hint.dtypes)
    if hint in _PLAIN:
        return _PLAIN[hint]
    if not inspect.isclass(hint) or hint.__module__.split(".")[0] not in ("sfgs_jax", "jaxlie"):
        return None
    if getattr(hint, "_is_protocol", False):
        return _protocol(hint)
    return Kind(f"a {hint.__name__}", lambda value, _: isinstance(value, hint))


def _any_of(options: list[Kind | None]) -> Kind | None:
    kinds = [kind for kind in options if kind is not None]
    if len(kinds) < len(options):
        return None
    texts = list(dict.fromkeys(kind.text for kind in kinds))
    text = texts[0] if len(texts) == 1 else f"{', '.join(texts[:-1])} or {texts[-1]}"
    names = tuple(dict.fromkeys(name for kind in kinds for name in kind.names))
    return Kind(text, lambda value, sizes: any(kind.fits(value, sizes) for kind in kinds), names)


def _series(origin: Any, options: tuple[Any, ...]) -> Kind | None:
    """Several values of one kind, or a tuple of a fixed length."""
    fixed = origin is tuple and Ellipsis not in options
    kinds = [kind_of(option) for option in options if option is not Ellipsis]
    if None in kinds or not kinds:
        return None
    first = typing.cast(Kind, kinds[0])
    text = f"{len(kinds)} values, each {first.text}" if fixed else f"a sequence, each entry {first.text}"

    def fits(value: Any, sizes: Sizes) -> bool:
        if isinstance(value, str) or not (isinstance(value, Sequence) or (is_array(value) and value.ndim)):
            return False
        if fixed and len(value) != len(kinds):
            return False
        # The first entries tell; a list of all frames is long.
        return all(first.fits(entry, {**sizes}) for entry in value[:_LOOKED_AT])

    return Kind(text, fits)


def _protocol(hint: type) -> Kind | None:
    """An object with the attributes of a protocol; they are looked up, not computed."""
    names = [name for name in vars(hint) if not name.startswith("_")]
    if not names:
        return None

    def fits(value: Any, _: Sizes) -> bool:
        held = getattr(value, "__dict__", {})
        return all(hasattr(type(value), name) or name in held for name in names)

    return Kind(f"a {hint.__name__}", fits)


def _array(dims: str, dtypes: Any) -> Kind | None:
    """An array of the kind of numbers and the shape of an annotation of jaxtyping."""
    words = [dtypes] if isinstance(dtypes, str) else list(dtypes) if isinstance(dtypes, tuple | list) else []
    letters = {letter for word in words if (letter := _letter(word)) is not None}
    if any(_letter(word) is None for word in words):
        return None
    shape = dims.split()
    names = tuple(word for word in shape if word.isidentifier() and not word.startswith("_"))
    numbers = _NUMBERS[next(iter(letters))] if len(letters) == 1 else "numbers"
    text = f"an array of {numbers}{f' ({_shape_text(shape)})' if shape not in ([], ['...']) else ''}"
    text = f"a number or {text} without axes" if not shape else text

    def fits(value: Any, sizes: Sizes) -> bool:
        if not is_array(value):
            return not shape and _is_number(value, sizes)
        letter = value.dtype.kind
        right = _SAME.get(letter, letter) in letters if letters else letter in "fiubcV"
        return right and _shape_fits(value.shape, shape, sizes)

    return Kind(text, fits, names)


_SAME = {"u": "i", "V": "f"}
"""Integers without a sign are integers; types of 16 bits and fewer that NumPy does not know are floats."""


def _letter(word: str) -> str | None:
    for start, letter in (("float", "f"), ("bfloat", "f"), ("int", "i"), ("uint", "i"), ("bool", "b")):
        if word.startswith(start):
            return letter
    return "c" if word.startswith("complex") else None


def _shape_text(shape: list[str]) -> str:
    words = ["..." if word.startswith("*") else word for word in shape]
    return ", ".join(words) if len(words) > 1 else f"{words[0]},"


def _shape_fits(found: tuple[int, ...], shape: list[str], sizes: Sizes) -> bool:
    """Whether a shape is as wanted; notes the sizes of new names."""
    many = next((i for i, word in enumerate(shape) if word.startswith("*") or word == "..."), None)
    if many is None:
        return len(found) == len(shape) and all(map(_size_fits, found, shape, [sizes] * len(shape)))
    last = len(shape) - many - 1
    if len(found) < len(shape) - 1:
        return False
    middle = found[many : len(found) - last]
    if shape[many].startswith("*") and sizes.setdefault(shape[many], middle) != middle:
        return False
    ends = (*found[:many], *found[len(found) - last :])
    return all(map(_size_fits, ends, shape[:many] + shape[many + 1 :], [sizes] * len(ends)))


def _size_fits(size: int, word: str, sizes: Sizes) -> bool:
    if word.isdecimal():
        return size == int(word)
    return not word.isidentifier() or word.startswith("_") or sizes.setdefault(word, size) == size


def _is_word(value: Any) -> bool:
    return value is None or isinstance(value, str | int)


def _is_number(value: Any, _: Sizes) -> bool:
    if isinstance(value, float | np.floating):
        return bool(value == value)
    return (isinstance(value, Real) and not isinstance(value, bool)) or (
        is_array(value) and value.shape == () and value.dtype.kind in "fiuV"
    )


def _is_whole(value: Any, _: Sizes) -> bool:
    return (isinstance(value, Integral) and not isinstance(value, bool)) or (
        is_array(value) and value.shape == () and value.dtype.kind in "iu"
    )


def rigid(kind: Kind) -> Kind:
    """The kind of a 4 x 4 matrix, or of a motion, that must be a rigid one if it is a single matrix of NumPy.

    Args:
        kind: of the argument.
    """

    def fits(value: Any, sizes: Sizes) -> bool:
        if not kind.fits(value, sizes):
            return False
        if not isinstance(value, np.ndarray) or value.shape != (4, 4):
            return True
        R = value[:3, :3]
        return bool(
            np.isfinite(value).all()
            and (np.abs(value[3] - _LAST_ROW) < _RIGID).all()
            and (np.abs(R @ R.T - _IDENTITY) < _RIGID).all()
            and R[0] @ np.cross(R[1], R[2]) > 0
        )

    return Kind(f"{kind.text}, which is a rigid motion", fits, kind.names)


_IDENTITY, _LAST_ROW = np.eye(3), np.array([0, 0, 0, 1])
_RIGID = 1e-2
"""Largest error of orthonormality: matrices in text files have few digits."""


def _is_path(value: Any, _: Sizes) -> bool:
    return isinstance(value, Path | str) and can_be_path(value)


_PATH = Kind("the path of a file or a folder, pathlib.Path or str", _is_path)
_NUMBER = Kind("a number", _is_number)
_PLAIN = {
    float: _NUMBER,
    complex: _NUMBER,
    np.number: _NUMBER,
    int: Kind("a whole number", _is_whole),
    bool: Kind("True or False", lambda value, _: isinstance(value, bool | np.bool_) or is_array(value)),
    str: Kind("text", lambda value, _: isinstance(value, str)),
    jax.Array: Kind("an array", lambda value, _: is_array(value)),
    type(None): Kind("None", lambda value, _: value is None),
    Path: Kind("a pathlib.Path", lambda value, _: isinstance(value, Path) and _is_path(value, _)),
}
