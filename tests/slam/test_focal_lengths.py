"""What keyframes tell about the focal lengths, and frames that are lost for it."""

import re
from dataclasses import replace

import numpy as np
import pytest

from sfgs_jax import Camera, slam
from sfgs_jax.datasets import SyntheticRecording
from sfgs_jax.geometry import se3
from sfgs_jax.slam.keyframes import focal_lengths_by
from sfgs_jax.slam.state import FocalInformation


def stretched(camera: Camera, factor: float) -> Camera:
    return replace(camera, fx=factor * camera.fx, fy=factor * camera.fy)


@pytest.fixture(scope="module")
def recording():
    return SyntheticRecording(num_frames=60, width=256, height=192)


@pytest.mark.parametrize("factor", [1.0, 1.02, 0.97])
def test_a_registration_tells_the_focal_lengths(recording, factor):
    params = slam.tracker_params(stretched(recording.camera, factor), slam.SlamConfig().tracking)
    told = FocalInformation()
    for numbers in ((0, 8), (20, 30)):
        a, b = (slam.observe(params, recording[number]) for number in numbers)
        found = slam.register(params, b, a, slam.register(params, b, a, se3.identity()).T_target_source)
        told = told.joined(focal_lengths_by(params, b, a, found))
    error, sigma = told.estimate()
    assert told.count == 2
    assert abs(error + np.log(factor)) < 0.011
    assert abs(error + np.log(factor)) < sigma < 0.02


def test_where_nothing_moves_nothing_is_told(recording):
    params = slam.tracker_params(stretched(recording.camera, 1.05), slam.SlamConfig().tracking)
    a = slam.observe(params, recording[0])
    found = slam.register(params, a, a, se3.identity())
    error, sigma = focal_lengths_by(params, a, a, found).estimate()
    assert abs(error) < sigma / 10
    assert sigma > 0.1


def test_the_estimate_is_the_weighted_mean_and_its_deviation_covers_its_error(rng):
    errors = []
    for _ in range(300):
        told, information = FocalInformation(), rng.uniform(1e3, 1e4, 40)
        # Registrations err by three times what they say, as on real recordings.
        says = 0.01 + 3 * rng.normal(size=40) / np.sqrt(information)
        for i, x in zip(information, says, strict=True):
            told = told.joined(FocalInformation.of(i, i * x))
        mean, sigma = told.estimate()
        np.testing.assert_allclose(mean, np.sum(information * says) / np.sum(information), rtol=1e-9)
        errors.append((mean - 0.01) / sigma)
    assert 0.8 < np.std(errors) < 1.2


def test_registrations_that_say_the_same_count_once():
    once, often = FocalInformation(), FocalInformation()
    for says in (0.01, 0.03, 0.02, 0.05, -0.01, 0.03):
        once = once.joined(FocalInformation.of(1e4, 1e4 * says))
        for _ in range(4):
            often = often.joined(FocalInformation.of(1e4, 1e4 * says).of_which(0.25))
    np.testing.assert_allclose(often.estimate(), once.estimate(), rtol=1e-9)


def test_one_registration_alone_is_not_believed_at_its_word():
    told = FocalInformation.of(1e4, 1e4 * 0.05)
    np.testing.assert_allclose(told.estimate(), (0.05, np.sqrt(3) / 100))
    assert not told.is_beyond(0.02)
    for _ in range(9):
        told = told.joined(FocalInformation.of(1e4, 1e4 * 0.05))
    assert told.is_beyond(0.02)
    assert not told.is_beyond(0.06)


def test_chance_is_allowed_for_beside_the_limit():
    """1.6 % are five deviations from none, and still no more than 1.5 % and chance together."""
    told = FocalInformation()
    for says in 0.016 + 0.002 * np.asarray([-1.0, 1.0] * 10):
        told = told.joined(FocalInformation.of(5e3, 5e3 * says))
    error, sigma = told.estimate()
    np.testing.assert_allclose(error, 0.016, rtol=1e-6)
    assert 4.5 < error / sigma < 5.5
    assert told.is_beyond(0.0)
    assert not told.is_beyond(0.015)
    surer = told
    for _ in range(15):
        surer = surer.joined(told)
    assert surer.is_beyond(0.015)


def test_nothing_is_known_before_the_first_registration():
    nothing = FocalInformation()
    assert nothing.estimate() == (0.0, np.inf)
    assert not nothing.is_beyond(1e-6)
    assert FocalInformation.of(0.0, 0.0) == nothing


def test_frames_are_lost_once_focal_lengths_are_wrong(room, frames, config):
    state, info = slam.step(slam.init(room.camera, config), frames[0])
    assert info.tracked
    told = FocalInformation()
    for _ in range(30):
        told = told.joined(FocalInformation.of(1e5, 1e5 * float(np.log(0.97))))
    state = replace(state, graph=replace(state.graph, focal=told))
    with pytest.warns(UserWarning, match=r"Focal lengths are about 3.1 % too long: .* fx \d+\.\d and fy"):
        after, info = slam.step(state, frames[1])
    assert not info.tracked
    assert after.num_lost == 1
    lenient = replace(config, tracking=replace(config.tracking, max_focal_error=0.05))
    tracker = replace(state.params, config=lenient.tracking)
    _, info = slam.step(replace(state, config=lenient, params=tracker), frames[1])
    assert info.tracked


def test_a_run_with_wrong_focal_lengths_is_told_the_right_ones(config):
    recording = SyntheticRecording(num_frames=100, width=256, height=192)
    config = replace(config, tracking=slam.SlamConfig().tracking)
    state, infos = slam.init(stretched(recording.camera, 1.04), config), []
    for number in range(50):
        state, info, _ = slam.follow(state, recording[number])
        infos.append(info)
    told = [number for number, info in enumerate(infos) if info.contradiction]
    assert 20 < told[0] < 45
    assert told == list(range(told[0], 50))
    assert [info.tracked for info in infos] == [number < told[0] for number in range(50)]
    found = re.search(
        r"Focal lengths are about \d\.\d % too long: .* fits fx ([\d.]+) and fy", infos[-1].contradiction
    )
    assert abs(float(found[1]) / recording.camera.fx - 1) < 0.015
