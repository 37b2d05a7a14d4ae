"""The help of every option stands alone: a sentence or noun phrase that needs no other option's text."""

import ast
import dataclasses
import inspect
import re
import textwrap
import typing
from typing import Any

import pytest

from sfgs_jax.cli import (
    COMMANDS,
    BatchArguments,
    CheckArguments,
    DoctorArguments,
    EvalArguments,
    ExportArguments,
    MergeArguments,
    RenderArguments,
    RunOptions,
    ViewArguments,
    main,
)

SETTINGS = {
    "check": CheckArguments,
    "run": RunOptions,
    "batch": BatchArguments,
    "merge": MergeArguments,
    "eval": EvalArguments,
    "view": ViewArguments,
    "render": RenderArguments,
    "export": ExportArguments,
    "doctor": DoctorArguments,
}
POSITIONAL = {
    "check": {"source"},
    "batch": {"path"},
    "merge": {"first", "second"},
    "eval": {"folder"},
    "view": {"path"},
    "render": {"path"},
    "export": {"source", "out"},
}
"""Arguments without a name on the command line."""

CONTINUES = re.compile(r"(and|or|nor|but|which|whose|who|what|of|where|those)\b", re.IGNORECASE)
"""Words with which no sentence begins."""
REFERS = re.compile(r"(that|these|it|its|as|how|by|when)\b", re.IGNORECASE)
"""Words with which no text begins, because they refer to one before."""
MOST_WORDS = 25


def attribute_texts(kind: type) -> dict[str, str]:
    """Docstrings of a dataclass's fields by their names."""
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    assert isinstance(definition, ast.ClassDef)
    texts = {}
    for field, text in zip(definition.body, definition.body[1:], strict=False):
        if (
            isinstance(field, ast.AnnAssign)
            and isinstance(field.target, ast.Name)
            and isinstance(text, ast.Expr)
            and isinstance(text.value, ast.Constant)
        ):
            texts[field.target.id] = str(text.value.value)
    return texts


def option_texts(kind: Any, prefix: str = "") -> dict[str, str]:
    """Help texts of the options that a dataclass makes, by their dotted names; "" for one without."""
    texts = attribute_texts(kind)
    hints = typing.get_type_hints(kind, include_extras=True)
    found: dict[str, str] = {}
    for field in dataclasses.fields(kind):
        hint, arguments = hints[field.name], ()
        if typing.get_origin(hint) is typing.Annotated:
            hint, *arguments = typing.get_args(hint)
        given = [text for argument in arguments if (text := getattr(argument, "help", None))]
        names = [name for argument in arguments if (name := getattr(argument, "name", None)) is not None]
        if dataclasses.is_dataclass(hint):
            inner = prefix if names == [""] else f"{prefix}{field.name}."
            found |= option_texts(hint, inner)
        else:
            found[f"{prefix}{field.name}"] = given[0] if given else texts.get(field.name, "")
    return found


OPTIONS = {
    (command, name): " ".join(text.split())
    for command, kind in SETTINGS.items()
    for name, text in option_texts(kind).items()
}


def shown(command: str, capsys) -> str:
    """The help of a command without its frame, white space made single."""
    with pytest.raises(SystemExit) as caught:
        COMMANDS[command].run(["--help-all" if command == "run" else "--help"])
    assert caught.value.code == 0
    return " ".join(re.sub(r"[│╭╮╰╯─]", " ", capsys.readouterr().out).split())


@pytest.mark.parametrize("command", SETTINGS)
def test_every_option_is_shown_with_its_text(command, capsys):
    help_text = shown(command, capsys)
    flags = set(re.findall(r"--([a-z][a-z.-]*)", help_text)) - {"help"}
    # The negation of a switch stands beside it: --graph.no-loops.
    flags = {flag for flag in flags if not re.search(r"(^|\.)no-", flag)}
    ours = {name.replace("_", "-") for own, name in OPTIONS if own == command}
    assert flags == ours - POSITIONAL.get(command, set())
    for (own, name), text in OPTIONS.items():
        if own == command:
            assert text in help_text, name


def test_the_help_of_a_run_fits_two_screens(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    assert main(["run", "--help"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= 60
    assert max(map(len, lines)) <= 100
    flags = [line.split()[0] for line in lines if line.startswith("  --")]
    assert 15 <= len(flags) <= 25
    assert {"--out", "--resume", "--evaluate,", "--reader.depth-scale", "--mapping.final-steps"} <= set(flags)
    assert "Folder for the results." in " ".join(lines)
    assert lines[-1].endswith("sfgs-jax run --help-all")
    assert main(["run", "somewhere", "-h"]) == 0


def test_options_of_the_short_help_exist(capsys):
    assert main(["run", "--help"]) == 0
    named = set(re.findall(r"--[a-z][a-z.-]*[a-z]", capsys.readouterr().out)) - {"--help-all"}
    everything = shown("run", capsys)
    assert named <= set(re.findall(r"--[a-z][a-z.-]*[a-z]", everything))
    assert "no-no-" not in everything


def test_the_two_sources_of_options_are_complete():
    assert set(SETTINGS) == set(COMMANDS)
    assert len(OPTIONS) > 100


@pytest.mark.parametrize(("command", "name"), OPTIONS)
def test_every_text_stands_alone(command, name):
    text = OPTIONS[command, name]
    assert text, "an option without a text"
    assert "..." not in text
    assert text.endswith(".")
    assert not REFERS.match(text)
    for sentence in re.split(r"(?<=[.!?;]) (?=[A-Z`])", text):
        assert re.match(r"[A-Z`]|\d", sentence), sentence
        assert not CONTINUES.match(sentence), sentence
        assert len(sentence.split()) <= MOST_WORDS, sentence
