"""Selection of source pixels, and their correspondences in the window of an organised target."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.geometry import Camera, se3
from sfgs_jax.gicp import GicpConfig, associate, level_problem, prepare
from tests.gicp.scenes import cast

CAMERA = Camera(120.0, 120.0, 63.5, 47.5, width=128, height=96)
CONFIG = GicpConfig(max_distance=(2.0,), min_normal_cosine=(0.0,), strides=(4,), min_points=(1,))


def test_a_window_finds_the_nearest_point_of_its_pixels():
    levels = prepare(cast(CAMERA), CAMERA, config=CONFIG).levels
    level = levels[0]
    T = se3.exp(jnp.asarray([0.08, 0.02, 0.0, 0.0, 0.1, 0.02]))

    @partial(jax.jit, static_argnums=0)
    def matched(config):
        """Moved source points with their correspondences."""
        problem = level_problem(levels, levels, None, 0, config)
        return se3.transform(T, problem.source.points.T), *associate(problem.source, problem.target, T)

    moved = np.asarray(matched(CONFIG)[0])
    points = np.asarray(level.points).reshape(-1, 3)
    surface = np.any(np.asarray(level.normals).reshape(-1, 3) != 0, axis=1)
    u, v = np.meshgrid(np.arange(level.camera.width), np.arange(level.camera.height))
    at = np.round(np.asarray(level.camera.project(jnp.asarray(moved))))
    away = np.maximum(np.abs(u.reshape(-1) - at[:, :1]), np.abs(v.reshape(-1) - at[:, 1:]))
    distance = np.linalg.norm(moved[:, None] - points, axis=2)
    results = []
    for radius in (0, 3):
        _, pairs, index = matched(replace(CONFIG, windows=(radius,)))
        found = np.asarray(pairs.valid)
        assert found.mean() > 0.4
        expected = np.where((away <= radius) & surface, distance, np.inf).min(axis=1)
        got = distance[np.arange(len(moved)), np.asarray(index)]
        np.testing.assert_allclose(got[found], expected[found], rtol=1e-5)
        results.append((got, found))
    (by_pixel, a), (by_window, b) = results
    assert by_window[a & b].mean() < 0.95 * by_pixel[a & b].mean()


@pytest.mark.parametrize(("width", "height", "stride"), [(640, 480, 2), (320, 240, 2), (160, 120, 1)])
def test_small_images_keep_all_their_pixels(width, height, stride):
    camera = Camera(width, width, width / 2, height / 2, width=width, height=height)
    levels = prepare(np.full((height, width), 2.0, np.float32), camera).levels
    problem = jax.jit(lambda levels: level_problem(levels, levels, None, 0, GicpConfig()))(levels)
    assert problem.source.valid.size == levels[0].valid[::stride, ::stride].size
