"""docs/viewer.md: its examples run, and its controls and options exist."""

import dataclasses
import inspect
import re
from pathlib import Path
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.cli import ViewArguments
from sfgs_jax.geometry import Trajectory, format_tum
from sfgs_jax.splatting import Gaussians, load_spz, save_ply
from sfgs_jax.viewer import MapScene

GUIDE = (Path(__file__).parents[2] / "docs" / "viewer.md").read_text().split("\n## Live\n")[0]
FOLDER_EXAMPLE, MEMORY_EXAMPLE = re.findall(r"```python\n(.*?)```", GUIDE, re.DOTALL)


@pytest.fixture
def gaussians() -> Gaussians:
    return Gaussians(
        means=jnp.zeros((4, 3)),
        quaternions=jnp.tile(jnp.asarray([1.0, 0, 0, 0]), (4, 1)),
        log_scales=jnp.full((4, 3), -3.0),
        opacity_logits=jnp.zeros(4),
        sh=jnp.zeros((4, 1, 3)),
        valid=jnp.ones(4, bool),
    )


@pytest.fixture
def trajectory() -> Trajectory:
    poses = np.tile(np.eye(4), (6, 1, 1))
    poses[:, 0, 3] = np.linspace(0, 1, 6)
    return Trajectory(np.arange(6.0), poses)


def test_the_example_with_a_run_runs(gaussians, trajectory, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save_ply(tmp_path / "map.ply", gaussians)
    for name in ("trajectory.txt", "keyframes.txt"):
        (tmp_path / name).write_text(format_tum(trajectory))
    example = FOLDER_EXAMPLE.replace("runs/my_desk", str(tmp_path))
    assert example != FOLDER_EXAMPLE
    names: dict = {}
    exec(compile(example, "viewer.md", "exec"), names)  # the text under test is our own
    np.testing.assert_allclose(names["scene"].replay.position, trajectory.positions[2], atol=1e-6)
    assert len(load_spz(tmp_path / "cropped.spz").means) == 4


def test_the_example_with_a_map_in_memory_runs(gaussians, trajectory):
    names: dict = {"state": SimpleNamespace(gaussians=gaussians, trajectory=trajectory)}
    try:
        exec(compile(MEMORY_EXAMPLE, "viewer.md", "exec"), names)
        assert len(names["scene"].splats.centers) == 4
        assert len(names["scene"].frusta) == 1
    finally:
        names["scene"].close()


def test_every_control_and_option_exists():
    controls = re.findall(r"^\| ([A-Z][A-Za-z ,]+) \|", GUIDE, re.MULTILINE)
    assert len(controls) == 20
    source = (Path(inspect.getfile(MapScene)).parent / "_controls.py").read_text()
    names = [name for control in controls for name in control.split(", ")]
    assert all(f'"{name}"' in source for name in names)
    made = re.findall(r'gui\.add_(?!markdown|divider)\w+\(\s*"(\w[^"]*)"', source)
    assert set(made) - {"Stop", "Format"} == set(names)
    options = {f"--{field.name.replace('_', '-')}" for field in dataclasses.fields(ViewArguments)}
    named = set(re.findall(r"`(--[a-z-]+)", GUIDE))
    assert named == options - {"--path"}
    for name in re.findall(r"`scene\.([a-z]+)`", GUIDE):
        assert name in inspect.getdoc(MapScene)
