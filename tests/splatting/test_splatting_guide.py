"""The guide's examples run, and their assertions hold."""

import re
from pathlib import Path

GUIDE = Path(__file__).parents[2] / "docs" / "splatting.md"


def test_the_walk_from_parameters_to_a_pixel_and_back_holds():
    blocks = re.findall(r"```python\n(.*?)```", GUIDE.read_text(encoding="utf-8"), re.DOTALL)
    walk = "\n".join(blocks[1:])  # the first is a sketch with a map that is not there
    assert walk.count("assert") > 8
    exec(walk, {})
