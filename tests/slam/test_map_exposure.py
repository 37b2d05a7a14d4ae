"""Colours of a map and gains of its views, which go together."""

from dataclasses import replace

import numpy as np

from sfgs_jax import slam
from sfgs_jax.geometry import se3
from sfgs_jax.slam.mapping import in_the_mean_exposure
from sfgs_jax.slam.state import Submap
from sfgs_jax.splatting import render, sh_to_rgb


def test_colours_times_gains_stay_and_the_mean_gain_becomes_one(room, frames, config):
    state, _ = slam.step(slam.init(room.camera, config), frames[0])
    gains = np.asarray([[0.5, 1.0, 2.0], [1.5, 1.2, 2.0]], np.float32)
    views = tuple(replace(state.mapping.views[0], gain=gain) for gain in gains)
    submap = Submap(state.mapping.map, 0, 0, np.zeros((2, 3), np.float32))
    before = replace(state.mapping, views=views, submaps=(submap,), num_submaps=1)
    after = in_the_mean_exposure(before)
    mean = gains.mean(axis=0)
    np.testing.assert_allclose([view.gain for view in after.views], gains / mean, rtol=1e-6)
    for old, new in (
        (before.map, after.map),
        (before.submaps[0].content, after.submaps[0].content),
    ):
        colours = [sh_to_rgb(np.asarray(m.gaussians.sh)[:, 0]) for m in (old, new)]
        np.testing.assert_allclose(colours[1], colours[0] * mean, atol=1e-6)
    # A file on disk stands for a number, and its content is another one.
    assert after.submaps[0].number == 1
    assert after.num_submaps == 2
    images = [np.asarray(render(m.map.gaussians, room.camera, se3.identity()).rgb) for m in (before, after)]
    np.testing.assert_allclose(images[1], images[0] * mean, atol=2e-5)


def test_a_map_in_its_mean_exposure_is_left_alone(room, frames, config):
    """Nothing is written again for it, and no colour changes by rounding."""
    state, _ = slam.step(slam.init(room.camera, config), frames[0])
    gains = np.asarray([[0.5, 1.0, 1.25], [1.5, 1.0, 0.75]], np.float32)
    views = tuple(replace(state.mapping.views[0], gain=gain) for gain in gains)
    before = replace(state.mapping, views=views)
    assert in_the_mean_exposure(before) is before
