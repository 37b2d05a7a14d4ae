"""The guide's camera.json is one that is read."""

import re
from pathlib import Path

from sfgs_jax.datasets import LAYOUTS
from sfgs_jax.datasets.intrinsics import EXAMPLE, read_camera_json

GUIDE = Path(__file__).parents[2] / "docs" / "datasets.md"


def test_examples_of_camera_files_are_read(tmp_path):
    examples = re.findall(r"```json\n(.*?)```", GUIDE.read_text(), re.DOTALL)
    assert examples
    for text in (*examples, EXAMPLE):
        (tmp_path / "camera.json").write_text(text)
        intrinsics = read_camera_json(tmp_path / "camera.json")
        assert (intrinsics.fx, intrinsics.cy, intrinsics.depth_scale) == (525.0, 239.5, 1000.0)
        assert not intrinsics.notes


def test_every_layout_is_named():
    text = GUIDE.read_text()
    assert all(f"`{layout}`" in text for layout in LAYOUTS)
