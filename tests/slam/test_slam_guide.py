"""What docs/slam.md shows works as it stands there."""

import contextlib
import re
from pathlib import Path

from sfgs_jax.cli.main import main

GUIDE = (Path(__file__).parents[2] / "docs" / "slam.md").read_text()


def test_the_example_runs(capsys):
    (example,) = re.findall(r"```python\n(.*?)```", GUIDE, re.DOTALL)
    small = example.replace("frames=20", "frames=3,width=96,height=72")
    assert small != example
    names: dict = {}
    exec(compile(small, "slam.md", "exec"), names)  # the text under test is our own
    shown = capsys.readouterr().out.splitlines()
    assert len(shown) == 3
    assert shown[0] == "True BOTH True"
    assert len(names["trajectory"]) == 3


def test_every_option_it_names_exists(capsys):
    with contextlib.suppress(SystemExit):
        main(["run", "--help"])
    known = set(re.findall(r"--[a-z][a-z.-]*", capsys.readouterr().out))
    named = set(re.findall(r"`(--[a-z][a-z.-]*)", GUIDE))
    assert len(named) > 8
    assert named <= known, named - known
