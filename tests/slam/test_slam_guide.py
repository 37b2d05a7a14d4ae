"""The options that docs/slam.md names exist. Its examples run in `tests/test_examples.py`."""

import contextlib
import re
from pathlib import Path

from sfgs_jax.cli import main

GUIDE = (Path(__file__).parents[2] / "docs" / "slam.md").read_text()


def test_it_has_two_examples():
    """Both run in `tests/test_examples.py`."""
    assert len(re.findall(r"```python\n", GUIDE)) == 2


def test_every_option_it_names_exists(capsys):
    with contextlib.suppress(SystemExit):
        main(["run", "--help-all"])
    known = set(re.findall(r"--[a-z][a-z.-]*", capsys.readouterr().out))
    named = set(re.findall(r"`(--[a-z][a-z.-]*)", GUIDE))
    assert len(named) > 8
    assert named <= known, named - known
