"""docs/datasets.md: its camera files can be read, and it names every layout and every option."""

import dataclasses
import re
from pathlib import Path

from sfgs_jax.datasets import LAYOUTS, ReaderOptions
from sfgs_jax.datasets.files import CAMERA_EXAMPLE, read_camera_json
from sfgs_jax.datasets.synthetic import PLACES

GUIDE = Path(__file__).parents[2] / "docs" / "datasets.md"


def test_examples_of_camera_files_are_read(tmp_path):
    examples = re.findall(r"```json\n(.*?)```", GUIDE.read_text(), re.DOTALL)
    assert examples
    for text in (*examples, CAMERA_EXAMPLE):
        (tmp_path / "camera.json").write_text(text)
        intrinsics = read_camera_json(tmp_path / "camera.json")
        assert (intrinsics.fx, intrinsics.cy, intrinsics.depth_scale) == (525.0, 239.5, 1000.0)
        assert not intrinsics.notes


def test_every_layout_option_and_place_is_named():
    text = GUIDE.read_text()
    options = [field.name for field in dataclasses.fields(ReaderOptions)]
    for name in (*LAYOUTS, *options, *(place for place in PLACES if place != "room")):
        assert f"`{name}`" in text, name
