"""Every example runs, and its numbers show that it works."""

import runpy
from collections.abc import Callable
from pathlib import Path

import jax

EXAMPLES = Path(__file__).parents[1] / "examples"


def main_of(name: str) -> Callable[..., dict[str, float]]:
    """The `main` of an example, whose file name begins with a digit and so can't be imported."""
    return runpy.run_path(str(EXAMPLES / f"{name}.py"))["main"]


def test_every_example_is_run_here():
    tested = Path(__file__).read_text(encoding="utf-8")
    names = sorted(path.stem for path in EXAMPLES.glob("*.py"))
    assert len(names) > 4
    for name in names:
        assert f'main_of("{name}")' in tested


def test_00_the_fit_raises_psnr_of_a_view_it_has_not_seen():
    with jax.numpy_dtype_promotion("standard"):  # optax mixes integers and floats
        found = main_of("00_render_and_fit")(width=96, height=72, steps=60)
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


def test_05_a_batch_of_recordings_is_tracked_as_one_program():
    found = main_of("05_scan_and_vmap")(width=96, height=72, frames=8, batch=2)
    assert found["tracked"] == 1
    assert found["worst_cm"] < 1


def test_06_the_gradient_through_tracking_finds_the_focal_length():
    found = main_of("06_gradient_through_tracking")(width=96, height=72, steps=3)
    assert found["first_error"] > 0.04
    assert found["last_error"] < 0.005
