"""The README: its example runs, its tables and commands are complete."""

import re
from pathlib import Path

import jax.numpy as jnp
import pytest

import sfgs_jax
from sfgs_jax.cli import COMMANDS
from sfgs_jax.slam import OUTPUT_FILES

README = (Path(__file__).parents[1] / "README.md").read_text()


def test_the_library_example_runs(capsys):
    (example,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    small = example.replace("frames=20", "frames=3,width=96,height=72")
    assert small != example
    names: dict[str, object] = {}
    exec(compile(small, "README.md", "exec"), names)  # the text under test is our own
    gradient = jnp.asarray([float(word) for word in capsys.readouterr().out.strip(" []\n").split()])
    assert gradient.shape == (6,)
    assert jnp.all(jnp.isfinite(gradient))
    assert jnp.any(gradient != 0)


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
