"""The examples of docs/slam.md run, and the options it names exist."""

import contextlib
import re
from pathlib import Path

from sfgs_jax.cli import main

GUIDE = (Path(__file__).parents[2] / "docs" / "slam.md").read_text()


EXAMPLES = re.findall(r"```python\n(.*?)```", GUIDE, re.DOTALL)


def test_the_first_example_steps_through_a_recording(capsys):
    small = EXAMPLES[0].replace("frames=20", "frames=3,width=96,height=72")
    assert small != EXAMPLES[0]
    names: dict = {}
    exec(compile(small, "slam.md", "exec"), names)  # the text under test is our own
    shown = capsys.readouterr().out.splitlines()
    assert len(shown) == 3
    assert shown[0] == "True JOINT True"
    assert len(names["trajectory"]) == 3


def test_the_second_example_scans_the_tracker(capsys):
    small = EXAMPLES[1].replace("frames=8,width=160,height=120", "frames=3,width=96,height=72")
    assert small != EXAMPLES[1]
    exec(compile(small, "slam.md", "exec"), {})  # the text under test is our own
    assert capsys.readouterr().out.strip() == "(3, 7)"
    assert len(EXAMPLES) == 2


def test_every_option_it_names_exists(capsys):
    with contextlib.suppress(SystemExit):
        main(["run", "--help"])
    known = set(re.findall(r"--[a-z][a-z.-]*", capsys.readouterr().out))
    named = set(re.findall(r"`(--[a-z][a-z.-]*)", GUIDE))
    assert len(named) > 8
    assert named <= known, named - known
