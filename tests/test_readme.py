"""The README: its tables and commands are complete. Its example runs in `test_examples.py`."""

import re
from pathlib import Path

import pytest

import sfgs_jax
from sfgs_jax.cli import COMMANDS
from sfgs_jax.slam import OUTPUT_FILES

README = (Path(__file__).parents[1] / "README.md").read_text()


def test_the_library_example_is_alone():
    """It runs among the examples."""
    assert len(re.findall(r"```python\n", README)) == 1


@pytest.mark.parametrize("name", OUTPUT_FILES)
def test_every_output_is_explained(name):
    assert f"`{name}`" in README


def test_every_command_is_shown():
    for command in COMMANDS:
        assert f"sfgs-jax {command}" in README


def test_the_public_names_are_at_the_top():
    for path in (
        "gicp.prepare",
        "gicp.align",
        "splatting.render",
        "splatting.load_ply",
        "splatting.save_ply",
        "slam.step",
    ):
        room, name = path.split(".")
        assert callable(getattr(getattr(sfgs_jax, room), name))
    assert sfgs_jax.Camera is sfgs_jax.geometry.Camera
