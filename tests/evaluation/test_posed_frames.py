"""Frames of a run with their poses, and the motion of the camera while they were exposed."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.evaluation import posed_frames
from sfgs_jax.geometry import Trajectory, format_tum, se3
from tests.evaluation.fabricated_run import ListRecording

TWIST = np.asarray([0.3, -0.1, 0.2, 0.4, -0.6, 0.5])
TIMES = {"depth_delay": 0.008, "colour_readout": 0.02, "depth_readout": 0.03}


@pytest.fixture
def run(tmp_path):
    """A camera in steady motion whose last two frames have one time stamp."""
    stamps = np.asarray([0.0, 0.1, 0.2, 0.3, 0.3])
    poses = se3.to_matrices(se3.exp(jnp.asarray(stamps[:, None] * TWIST, jnp.float32)))
    found = Trajectory(stamps, poses)
    (tmp_path / "trajectory.txt").write_text(format_tum(found))
    return tmp_path, ListRecording([], stamps, found)


def test_motion_is_that_between_the_neighbours(run):
    posed = posed_frames(*run)
    np.testing.assert_allclose(posed.twists[:3], np.tile(TWIST, (3, 1)), atol=1e-4)
    assert np.isfinite(posed.twists).all()


def test_rows_have_times_only_where_the_run_has_estimated_them(run):
    assert posed_frames(*run).shutter(0) is None
    (run[0] / "sensors.json").write_text(json.dumps({"times_s": TIMES}))
    shutter = posed_frames(*run).shutter(1)
    assert shutter is not None
    assert float(shutter.readout) == pytest.approx(0.02)
    np.testing.assert_allclose(shutter.twist, TWIST, atol=1e-4)
