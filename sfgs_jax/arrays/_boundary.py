"""Checks of a public function's arguments by its annotations and its docstring, which say what it takes.

Kind and shape of an array stand in its annotation, units in the docstring: an error quotes both. The checks
run on the host in microseconds. Under `jit` they run while a program is traced, which has nothing of them.
"""

import inspect
import re
from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar, cast

from sfgs_jax.arrays._argument_kinds import Kind, kind_of, rigid
from sfgs_jax.arrays._arguments import described, is_array
from sfgs_jax.arrays._errors import InputError
from sfgs_jax.arrays._excerpts import excerpt

_P = ParamSpec("_P")
_R = TypeVar("_R")

_MATRIX = "4, 4)"
"""Among the words for a motion."""
_LONGEST = 120
"""Characters that are quoted from a docstring."""


def checked_but(*others: str) -> Callable[[Callable[_P, _R]], Callable[_P, _R]]:
    """As `checked`, but for arguments that the function checks itself, in words of its own.

    Args:
        others: their names.
    """
    return lambda function: checked(function, others)


def checked(function: Callable[_P, _R], others: tuple[str, ...] = ()) -> Callable[_P, _R]:
    """The function, with its arguments checked before it runs.

    Arrays must have the annotated kind of numbers and shape, of NumPy or JAX; sizes of one name are equal.
    Numbers must not be NaN. What the annotations of other arguments say is checked as far as it is a class, a
    choice of words, or a path. Anything else is passed on.

    Args:
        function: a public function, compiled or not, with annotations of jaxtyping.
        others: arguments that are not checked here.

    Raises:
        InputError: as it is called, an argument is something else; the sentence names it and says what it is.
    """
    names: list[str] = []
    kinds: dict[str, Kind] = {}

    def prepare() -> None:
        for name, parameter in inspect.signature(function).parameters.items():
            if parameter.kind in (parameter.POSITIONAL_ONLY, parameter.POSITIONAL_OR_KEYWORD):
                names.append(name)
            several = parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD)
            kind = None if several or name in others else kind_of(parameter.annotation)
            if kind is not None:
                kinds[name] = rigid(kind) if _MATRIX in kind.text and name[:2] == "T_" else kind

    @wraps(function)
    def wrapper(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        # Not as the module is imported, which would take a tenth of a second for all of them.
        if not names and not kinds:
            prepare()
        sizes: dict[str, Any] = {}
        for name, value in (*zip(names, args, strict=False), *kwargs.items()):
            kind = kinds.get(name)
            if kind is not None and not kind.fits(value, sizes):
                raise InputError(_sentence(cast(Callable, function), name, kind, value, sizes))
        return function(*args, **kwargs)

    return wrapper


def _sentence(function: Callable, name: str, kind: Kind, value: Any, sizes: dict[str, Any]) -> str:
    what = _documented(function, name)
    known = [f"{size} = {sizes[size]}" for size in kind.names if isinstance(sizes.get(size), int)]
    rest = f" with {', '.join(known)}" if known and is_array(value) else ""
    shown = excerpt(value) if isinstance(value, str | int | float) else described(value)
    meaning = f" ({what})" if what else ""
    return f"{name} of {function.__name__} should be {kind.text}{rest}{meaning}, not {shown}."


def _documented(function: Callable, name: str) -> str:
    """What the docstring says of an argument, up to the end of its first clause, without the shape."""
    found = re.search(rf"^ *{name}: (.*(?:\n {{8,}}.*)*)", inspect.getdoc(function) or "", re.MULTILINE)
    if found is None:
        return ""
    text = " ".join(found[1].split())
    clause = re.split(r"[.;:](?:\s|$)", re.sub(r"^\([^)]*\) ", "", text))[0]
    return clause if len(clause) <= _LONGEST else ""
