"""The lens as a pure function: like the readers' on the host, and with the slopes of finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import Camera
from sfgs_jax.arrays import InputError
from sfgs_jax.sensors import Undistortion, undistorted

LENS = (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)
CAMERA = Camera(57.3, 56.5, 39.6, 29.3, width=80, height=60)


def images():
    """Smooth colour, and depth of a slanted plane with a near square before it."""
    v, u = np.mgrid[:60, :80].astype(np.float32)
    rgb = np.stack([np.sin(u / 9), np.cos(v / 7), np.sin((u + v) / 11)], axis=-1) / 2 + 0.5
    depth = 1 / (0.5 + 0.001 * u + 0.002 * v)
    depth[20:30, 20:30], depth[40:44, 50:54] = 1, 0
    return rgb.astype(np.float32), depth.astype(np.float32)


@pytest.mark.parametrize("lens", [LENS, LENS[:4], (*LENS, 0.1, -0.2, 0.05)])
def test_colour_and_depth_are_those_of_opencv(lens):
    host = Undistortion(CAMERA, lens)
    rgb, depth = undistorted(*images(), CAMERA, jnp.asarray(lens))
    expected_rgb, expected_depth = host(*images())
    # OpenCV's maps have 5 bits of a pixel; beyond the field of view both are black.
    np.testing.assert_allclose(np.asarray(rgb)[host.valid], expected_rgb[host.valid], atol=0.01)
    there = host.valid & (np.asarray(depth) > 0) & (expected_depth > 0)
    assert there.sum() > 0.9 * host.valid.sum()
    np.testing.assert_allclose(np.asarray(depth)[there], expected_depth[there], rtol=0.05)


def test_a_lens_without_distortion_changes_nothing():
    rgb, depth = images()
    same = undistorted(rgb, depth, CAMERA, jnp.zeros(5))
    np.testing.assert_allclose(same[0], rgb, atol=1e-5)
    np.testing.assert_allclose(same[1], depth, rtol=1e-5)


@pytest.mark.usefixtures("float64")
def test_derivatives_by_lens_and_intrinsics_are_those_of_finite_differences():
    rgb, depth = (jnp.asarray(x, jnp.float64) for x in images())
    camera = jax.tree.map(lambda x: jnp.asarray(x, jnp.float64), CAMERA)
    weights = jnp.cos(jnp.arange(60.0 * 80)).reshape(60, 80)

    @jax.jit
    @jax.value_and_grad
    def total(inputs):
        colour, z = undistorted(rgb, depth, *inputs)
        return jnp.sum(weights * z) + jnp.sum(weights[..., None] * colour)

    inputs = camera, jnp.asarray(LENS)
    _, slopes = total(inputs)
    leaves, tree = jax.tree.flatten(inputs)
    for place, slope in enumerate(jax.tree.leaves(slopes)):
        for i in range(slope.size):
            step = 1e-7 * jnp.zeros(slope.size).at[i].set(1).reshape(slope.shape)
            ends = [
                total(tree.unflatten([x + s * step if n == place else x for n, x in enumerate(leaves)]))[0]
                for s in (1, -1)
            ]
            assert float(ends[0] - ends[1]) / 2e-7 == pytest.approx(float(slope.ravel()[i]), rel=1e-5)


def test_another_number_of_coefficients_is_refused():
    with pytest.raises(InputError, match=r"4, 5 or 8 coefficients .* not 3"):
        undistorted(*images(), CAMERA, jnp.zeros(3))
