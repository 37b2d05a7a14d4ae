"""Renderings of a rolling shutter against one for each row and each moment, and its gradients."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.geometry import se3
from sfgs_jax.sensors import RollingShutter, row_places
from sfgs_jax.splatting import render
from tests.splatting.scenes import CONFIG, EXACT, HEIGHT, images_of, make_camera, make_pose, make_scene

TWIST = jnp.asarray([0.3, -0.2, 0.1, 0.4, 0.9, -0.5])
READOUT = 0.03


def fields(dtype=jnp.float32):
    """A scene of small Gaussians, so that each lies in few rows; camera and pose."""
    scene = make_scene(3, dtype)
    small = replace(scene, log_scales=scene.log_scales - 1.5)
    return small, make_camera(dtype=dtype), make_pose(dtype)


def test_a_row_is_drawn_from_where_the_camera_was_when_it_was_exposed():
    scene, camera, T = fields()
    draw = jax.jit(lambda pose: render(scene, camera, pose, config=CONFIG).rgb)
    times = READOUT * row_places(jnp.arange(HEIGHT, dtype=jnp.float32), HEIGHT)
    rows = [draw(se3.compose(T, se3.exp(t * TWIST)))[i] for i, t in enumerate(times)]
    exact = np.asarray(jnp.stack(rows))
    shutter = RollingShutter(TWIST, READOUT)
    rolling = np.asarray(jax.jit(lambda: render(scene, camera, T, shutter=shutter, config=CONFIG).rgb)())
    still = np.asarray(draw(T))
    # A Gaussian has one time, that of its centre's row; the rows beside it have theirs.
    assert np.mean(abs(rolling - exact)) < 0.25 * np.mean(abs(still - exact))


def test_a_camera_at_rest_or_a_global_shutter_changes_nothing():
    scene, camera, T = fields()
    draw = jax.jit(lambda shutter: images_of(render(scene, camera, T, shutter=shutter, config=CONFIG)))
    wanted = draw(None)
    np.testing.assert_array_equal(draw(RollingShutter(jnp.zeros(6), READOUT)), wanted)
    np.testing.assert_array_equal(draw(RollingShutter(TWIST, 0.0)), wanted)
    np.testing.assert_array_equal(draw(RollingShutter(TWIST, 0.0, 0.0)), wanted)


@pytest.mark.parametrize("antialiased", [False, True])
def test_an_exposed_image_is_the_mean_of_its_moments(antialiased: bool):
    scene, camera, T = fields()
    config = replace(CONFIG, antialiased=antialiased)
    draw = jax.jit(lambda pose, shutter: render(scene, camera, pose, shutter=shutter, config=config).rgb)
    exposure = 0.03
    moments = [draw(se3.compose(T, se3.exp(exposure * t * TWIST)), None) for t in np.arange(-12, 13) / 25]
    exact = np.asarray(jnp.stack(moments)).mean(axis=0)
    blurred, sharp = (np.asarray(draw(T, RollingShutter(TWIST, 0.0, e))) for e in (exposure, None))
    assert np.mean(abs(blurred - exact)) < 0.3 * np.mean(abs(sharp - exact))
    # Light that is spread is not lost.
    assert blurred.sum() == pytest.approx(exact.sum(), rel=0.01)


@pytest.mark.usefixtures("float64")
def test_gradients_by_motion_and_times_agree_with_finite_differences(rng):
    scene, camera, T = fields(jnp.float64)
    target = jnp.asarray(rng.normal(size=(*camera.shape, 3)))

    def loss(values):
        shutter = RollingShutter(values[:6], values[6], values[7])
        return jnp.sum(render(scene, camera, T, shutter=shutter, config=CONFIG).rgb * target)

    both = jax.jit(jax.value_and_grad(loss), compiler_options=EXACT)
    at = jnp.concatenate([TWIST.astype(jnp.float64), jnp.asarray([READOUT, 0.02])])
    _, gradient = both(at)
    step = 1e-6
    for i, found in enumerate(gradient):
        ends = [float(both(at.at[i].add(sign * step))[0]) for sign in (1, -1)]
        assert float(found) == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-4, abs=1e-6)
