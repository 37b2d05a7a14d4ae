"""docs/command_line.md: the options and commands that it shows exist, and none is left out."""

import contextlib
import dataclasses
import re
import shlex
from pathlib import Path

import pytest

from sfgs_jax.cli import (
    ABLATIONS,
    COMMANDS,
    BatchArguments,
    CheckArguments,
    EvalArguments,
    ExportArguments,
    MergeArguments,
    RenderArguments,
    RunOptions,
    ViewArguments,
)

GUIDE = (Path(__file__).parents[2] / "docs" / "command_line.md").read_text()


def flags_of(command: str, capsys) -> set[str]:
    """Options in the help of a command."""
    with contextlib.suppress(SystemExit):
        COMMANDS[command].run(["--help-all" if command == "run" else "--help"])
    return set(re.findall(r"--[a-z][a-z.-]*[a-z]", capsys.readouterr().out))


def section(title: str) -> str:
    """The text of a section of the page."""
    return GUIDE.split(f"\n## {title}\n")[1].split("\n## ")[0]


@pytest.mark.parametrize(
    "page",
    ["index.md", "quick_start.md", "troubleshooting.md", "faq.md", "limits.md", "tutorials/own_capture.md"],
)
def test_options_of_other_pages_exist(page, capsys):
    """Of the command that a line runs, else of `run`."""
    text = (Path(__file__).parents[2] / "docs" / page).read_text()
    checked = 0
    for line in text.splitlines():
        command = re.search(r"sfgs-jax ([a-z]+)", line)
        name = (
            command.group(1) if command and command.group(1) in ("run", "view", "export", "render") else "run"
        )
        if named := set(re.findall(r"--[a-z][a-z.-]*[a-z]", line)):
            assert named <= flags_of(name, capsys), line
        checked += len(named)
    assert checked >= 3


@pytest.mark.parametrize("command", ["check", "run", "batch", "merge", "eval", "view", "render", "export"])
def test_every_option_it_names_exists(command, capsys):
    # A group of options is written --reader.*
    named = set(re.findall(r"(--[a-z][a-z.-]*[a-z])(?![a-z.-]*\.\*)", section(command)))
    assert len(named) >= 2
    flags = flags_of(command, capsys)
    if command == "batch":
        # The lines of its list hold options of runs.
        flags |= flags_of("run", capsys)
    assert named <= flags


@pytest.mark.parametrize(
    ("command", "kind"),
    [
        ("check", CheckArguments),
        ("run", RunOptions),
        ("batch", BatchArguments),
        ("merge", MergeArguments),
        ("eval", EvalArguments),
        ("view", ViewArguments),
        ("render", RenderArguments),
        ("export", ExportArguments),
    ],
)
def test_no_option_is_left_out(command, kind):
    text = section(command)
    for field in dataclasses.fields(kind):
        name = field.name.replace("_", "-")
        shown = any(f"`--{form}`" in text for form in (name, f"no-{name}"))
        assert shown or name in (
            "folder",
            "path",
            "source",
            "first",
            "second",
            "out",
            "slam",
            "reader",
        ), name


def test_every_command_shown_is_one():
    lines = [line for block in re.findall(r"```\n(.*?)```", GUIDE, re.DOTALL) for line in block.splitlines()]
    assert len(lines) > 8
    for line in lines:
        program, command, target, *_ = shlex.split(line)
        assert program == "sfgs-jax"
        assert command in COMMANDS
        assert not target.startswith("-")
    for command in COMMANDS:
        assert f"`sfgs-jax {command}" in GUIDE


def test_every_ablation_is_described():
    rows = re.findall(r"^\| `([a-z][a-z-]*)` \|", section("run").split("### Ablations")[1], re.MULTILINE)
    assert tuple(rows) == ABLATIONS
