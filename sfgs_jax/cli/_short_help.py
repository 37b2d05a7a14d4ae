"""Help of a command with many settings: the options that most people need, and examples."""

import ast
import dataclasses
import inspect
import itertools
import shutil
import textwrap
import typing
from collections.abc import Sequence
from typing import Any

_LEAST_WIDTH, _MOST_WIDTH = 60, 100


def short_help(usage: str, kind: type, names: Sequence[str], examples: Sequence[str], more: str) -> str:
    """A page of help.

    Args:
        usage: line that shows how the command is called.
        kind: dataclass with the command's options, described by a docstring behind each field.
        names: options as the command line spells them, without the dashes; `no-NAME` shows both forms of a
            switch.
        examples: lines.
        more: last line.
    """
    width = min(max(shutil.get_terminal_size().columns, _LEAST_WIDTH), _MOST_WIDTH)
    texts = {_spelled(name): _text(kind, name.removeprefix("no-")) for name in names}
    column = max(map(len, texts)) + 4
    lines = [usage, ""]
    for name, text in texts.items():
        lead = f"  {name:<{column - 2}}"
        lines += textwrap.wrap(text, width, initial_indent=lead, subsequent_indent=" " * column)
    return "\n".join([*lines, "", "examples:", *(f"  {example}" for example in examples), "", more])


def _spelled(name: str) -> str:
    return f"--{name.removeprefix('no-')}, --{name}" if name.startswith("no-") else f"--{name}"


def _text(kind: type, dotted: str) -> str:
    """Help of an option: that which its field gives, else the docstring behind the field."""
    first, _, rest = dotted.partition(".")
    hints = typing.get_type_hints(kind, include_extras=True)
    fields = {field.name: field for field in dataclasses.fields(typing.cast(Any, kind))}
    name = first.replace("-", "_")
    if name in fields and not rest:
        given = [text for extra in _extras(hints[name]) if (text := getattr(extra, "help", None))]
        return given[0] if given else _docstrings(kind)[name]
    if name in fields:
        return _text(_bare(hints[name]), rest)
    # A group without a name gives its options to the one around it.
    (inner,) = [
        _bare(hint) for hint in hints.values() if any(getattr(e, "name", None) == "" for e in _extras(hint))
    ]
    return _text(inner, dotted)


def _bare(hint: Any) -> type:
    return typing.get_args(hint)[0] if typing.get_origin(hint) is typing.Annotated else hint


def _extras(hint: Any) -> tuple[Any, ...]:
    return typing.get_args(hint)[1:] if typing.get_origin(hint) is typing.Annotated else ()


def _docstrings(kind: type) -> dict[str, str]:
    """Docstrings behind the fields of a dataclass, on one line."""
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    body = definition.body if isinstance(definition, ast.ClassDef) else []
    found = {}
    for field, text in itertools.pairwise(body):
        if (
            isinstance(field, ast.AnnAssign)
            and isinstance(field.target, ast.Name)
            and isinstance(text, ast.Expr)
            and isinstance(text.value, ast.Constant)
        ):
            found[field.target.id] = " ".join(str(text.value.value).split())
    return found
