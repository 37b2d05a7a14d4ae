"""`sensors.json`: what a run has found about its camera, and the next run that starts from it."""

import json
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import slam
from sfgs_jax.arrays import InputError
from sfgs_jax.sensors import DEPTH_GRID, DepthCorrection, SensorModel, SensorTiming, read_sensors
from sfgs_jax.slam.run import write_sensors


@pytest.fixture
def known():
    offsets = np.linspace(-0.01, 0.02, 96, dtype=np.float32).reshape(DEPTH_GRID)
    extrinsic = jnp.asarray([0.01, -0.02, 0.005, 0.002, 0.004, -0.006])
    return SensorModel(SensorTiming(0.01, 0.02, 0.03), DepthCorrection(jnp.asarray(offsets), extrinsic))


def estimating(config, **settings):
    return replace(config, tracking=replace(config.tracking, **settings))


def test_the_next_run_begins_where_the_last_ended(room, config, known, tmp_path):
    both = estimating(config, estimate_timing=True, estimate_depth=True, estimate_extrinsic=True)
    state = slam.init(room.camera, both, known)
    write_sensors(state, tmp_path / "sensors.json")
    again = slam.init(room.camera, both, read_sensors(tmp_path / "sensors.json"))
    np.testing.assert_allclose(again.params.timing.vector, known.timing.vector, rtol=1e-6)
    assert again.params.depth_correction is not None
    np.testing.assert_allclose(again.params.depth_correction.offsets, known.depth.offsets, rtol=1e-6)
    np.testing.assert_allclose(again.params.depth_correction.vector, known.depth.vector, rtol=1e-6)
    np.testing.assert_allclose(again.graph.depth.start, known.depth.vector, rtol=1e-6)
    found = json.loads((tmp_path / "sensors.json").read_text())
    # Nothing was seen yet: these are the deviations of the prior. One camera in twenty has no extrinsic.
    assert found["times_sigma_s"]["depth_delay"] == pytest.approx(config.tracking.delay_sigma, rel=1e-3)
    assert np.shape(found["depth_offsets_sigma_per_m"]) == DEPTH_GRID
    shift, turn = config.tracking.extrinsic_shift_sigma, config.tracking.extrinsic_turn_sigma
    sigmas = 0.95**0.5 * np.repeat([shift, turn], 3)
    np.testing.assert_allclose(found["T_colour_depth_sigma"], sigmas, rtol=1e-6)


def test_a_file_without_an_extrinsic_says_that_there_is_none(known, tmp_path):
    path = tmp_path / "sensors.json"
    offsets = np.zeros(DEPTH_GRID).tolist()
    path.write_text(json.dumps({"depth_offsets_per_m": offsets}))
    assert read_sensors(path).depth.extrinsic is None
    for wrong in ([0.0] * 5, [1.0] * 6, [float("nan")] * 6, "wide"):
        path.write_text(json.dumps({"depth_offsets_per_m": offsets, "T_colour_depth_tangent": wrong}))
        with pytest.raises(InputError, match=r"sensors\.json"):
            read_sensors(path)


def test_a_run_that_estimates_nothing_writes_nothing(room, config, tmp_path):
    write_sensors(slam.init(room.camera, config), tmp_path / "sensors.json")
    assert not list(tmp_path.iterdir())


def test_what_has_no_effect_is_refused(room, config, known):
    with pytest.raises(InputError, match="estimate_timing"):
        slam.init(room.camera, config, SensorModel(timing=known.timing))
    with pytest.raises(InputError, match="estimate_depth"):
        slam.init(room.camera, config, SensorModel(depth=known.depth))


@pytest.mark.parametrize(
    "text",
    [
        "{",
        "[]",
        "{}",
        '{"times_s": {"depth_delay": 0.1}}',
        '{"times_s": 3}',
        '{"depth_offsets_per_m": [[1, 2]]}',
    ],
)
def test_another_file_is_refused_in_a_sentence(text, tmp_path):
    path = tmp_path / "sensors.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"sensors\.json"):
        read_sensors(path)
    with pytest.raises(InputError, match="Cannot read"):
        read_sensors(tmp_path / "none.json")
