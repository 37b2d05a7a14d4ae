"""docs/evaluation.md: its example runs, and it explains every figure, protocol and function."""

import re
import shutil
from pathlib import Path

import pytest

import sfgs_jax.evaluation.matching
from sfgs_jax.evaluation import PROTOCOLS, evaluate_run

GUIDE = (Path(__file__).parents[2] / "docs" / "evaluation.md").read_text()


def test_the_example_runs(capsys):
    (example,) = re.findall(r"```python\n(.*?)```", GUIDE, re.DOTALL)
    exec(compile(example, "evaluation.md", "exec"), {})  # the text under test is our own
    assert capsys.readouterr().out == "ATE 0.016 m, RPE 0.024 m\n"


def test_every_figure_is_explained(fabricated, tmp_path, monkeypatch, sfgs_data):
    monkeypatch.setenv("SFGS_DATA", str(sfgs_data))
    folder = shutil.copytree(fabricated[0], tmp_path / "run")
    metrics = evaluate_run(folder, fabricated[1])
    for group in ("ate", "rpe", "evaluated"):
        for name in metrics[group]:
            if name not in ("num_pairs", "delta_frames"):
                assert f"`{group}.{name}" in GUIDE, name
    for group in ("psnr", "ssim"):
        assert f"`{group}.PROTOCOL`" in GUIDE
    for name in metrics["lpips_squeeze"]:
        assert f"`lpips_squeeze.{name}`" in GUIDE
    assert "`unavailable`" in GUIDE


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_every_protocol_is_explained(protocol):
    assert re.search(rf"^\| `{protocol}` \|", GUIDE, re.MULTILINE)


def test_every_function_it_names_exists():
    table = GUIDE.split("## Keypoints and matches")[1]
    names = re.findall(r"`([a-z_]+)`", table)
    assert len(names) > 7
    assert all(callable(getattr(sfgs_jax.evaluation.matching, name)) for name in names)
