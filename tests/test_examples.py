"""Every example runs, and its numbers show that it works; those of the README and of the guide to SLAM too.

They are in one file because they step through frames of one size, by the same programs.
"""

import ast
import os
import re
import runpy
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
SMALLER = {"frames=20": "frames=3,width=96,height=72"}


def main_of(name: str) -> Callable[..., dict[str, float]]:
    """The `main` of an example, whose file name begins with a digit and so can't be imported."""
    return runpy.run_path(str(EXAMPLES / f"{name}.py"))["main"]


def test_every_example_is_run_here():
    tested = Path(__file__).read_text(encoding="utf-8")
    names = sorted(path.stem for path in EXAMPLES.glob("*.py"))
    assert len(names) > 4
    for name in names:
        assert f'main_of("{name}")' in tested or f"{name}.py" in tested


def test_00_the_fit_raises_psnr_of_a_view_it_has_not_seen():
    with jax.numpy_dtype_promotion("standard"):  # optax mixes integers and floats
        found = main_of("00_render_and_fit")(width=64, height=48, steps=60)
    assert found["fitted_after"] > found["fitted_before"] + 12
    assert found["held_out_after"] > found["held_out_before"] + 8


def test_01_alignment_is_good_to_millimetres():
    found = main_of("01_align")(width=160, height=120)
    assert found["converged"]
    assert found["moved_cm"] > 10
    assert found["error_cm"] < 0.5
    assert found["error_deg"] < 0.2
    assert found["sigma_cm"] < 1


def test_02_loops_bring_the_drift_down():
    found = main_of("02_pose_graph")()
    assert found["converged"]
    assert found["solved_cm"] < found["odometry_cm"] / 4
    assert found["off_cm"] < 4 * found["sigma_cm"] < 120


def test_03_matches_give_the_motion():
    found = main_of("03_match")(width=240, height=180)
    assert found["inliers"] > 50
    assert found["inliers"] > 0.5 * found["matches"]
    assert found["error_cm"] < found["moved_cm"] / 10
    assert found["error_deg"] < 0.5


def test_04_slam_tracks_and_maps_an_iterator():
    found = main_of("04_slam")(width=96, height=72, frames=12)
    assert found["tracked"] == 12
    assert found["ate_cm"] < 1
    assert found["gaussians"] > 1000
    assert found["psnr"] > 20


def run_in_small(page: str, index: int, changes: dict[str, str]) -> dict[str, Any]:
    """Names of one of the Python examples of a page, run with other words in it."""
    example = re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), re.DOTALL)[index]
    for words, others in changes.items():
        assert words in example
        example = example.replace(words, others)
    names: dict[str, Any] = {}
    exec(compile(example, page, "exec"), names)  # the text under test is our own
    return names


def test_the_readmes_example_steps_through_a_recording_and_differentiates_the_map(capsys):
    run_in_small("README.md", 0, SMALLER)
    gradient = jnp.asarray([float(word) for word in capsys.readouterr().out.strip(" []\n").split()])
    assert gradient.shape == (6,)
    assert jnp.all(jnp.isfinite(gradient))
    assert jnp.any(gradient != 0)


def test_the_first_example_of_the_guide_to_slam_steps_through_a_recording(capsys):
    names = run_in_small("docs/slam.md", 0, SMALLER)
    shown = capsys.readouterr().out.splitlines()
    assert len(shown) == 3
    assert shown[0] == "True JOINT True"
    assert len(names["trajectory"]) == 3


def test_the_second_example_of_the_guide_to_slam_scans_the_tracker(capsys):
    # One resolution is enough for so small an image, and a scan of four takes long to compile.
    smaller = {
        "frames=8,width=160,height=120": "frames=3,width=96,height=72",
        "import datasets, slam": "import datasets, gicp, slam",
        "TrackingConfig()": "TrackingConfig(gicp=gicp.GicpConfig(levels=1))",
    }
    run_in_small("docs/slam.md", 1, smaller)
    assert capsys.readouterr().out.strip() == "(3, 7)"


def test_05_a_batch_of_recordings_is_tracked_as_one_program():
    found = main_of("05_scan_and_vmap")(width=96, height=72, frames=8, batch=2)
    assert found["tracked"] == 1
    assert found["worst_cm"] < 1


def test_06_the_gradient_through_tracking_finds_the_focal_length():
    found = main_of("06_gradient_through_tracking")(width=96, height=72, steps=3)
    assert found["first_error"] > 0.04
    assert found["last_error"] < 0.005


def test_07_eight_devices_give_the_poses_of_one():
    """In a process of its own: the number of devices is fixed before the first array."""
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count=8"
    run = (
        f"import runpy; print(runpy.run_path({str(EXAMPLES / '07_batch_over_devices.py')!r})['main'](80, 60))"
    )
    done = subprocess.run(
        [sys.executable, "-c", run],
        env=os.environ | {"XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"},
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    found = ast.literal_eval(done.stdout.strip().splitlines()[-1])
    assert found["devices"] == 8
    assert found["difference"] < 1e-5
    assert found["spread"] > 1e-3
