"""Reprojection residuals: their Jacobians, missing depth, and points without an image."""

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest

from sfgs_jax import geometry
from sfgs_jax.geometry import NEAREST_DEPTH, Camera, se3

# One program instead of one for each operation.
reprojection_residuals = jax.jit(geometry.reprojection_residuals)


def camera(dtype=jnp.float64) -> Camera:
    made = Camera(500.0, 510.0, 320.0, 240.0, width=640, height=480)
    return jax.tree.map(lambda x: x.astype(dtype), made)


def scene(rng, count: int = 7):
    """World points in front of a camera that is turned and moved, and what it measures."""
    tangent = jnp.asarray(rng.normal(scale=0.2, size=6))
    world = jnp.asarray(rng.uniform([-1, -1, 2], [1, 1, 4], (count, 3)))
    pixels = jnp.asarray(rng.uniform(0, 480, (2, count)))
    depth = jnp.asarray(rng.uniform(1, 4, count)).at[1].set(0).at[2].set(jnp.nan)
    sigma, depth_sigma = (jnp.asarray(rng.uniform(0.5, 2, count)) for _ in range(2))
    return se3.exp(tangent), world, (pixels, depth), (sigma, depth_sigma)


def in_camera(T_world_cam: jaxlie.SE3, world):
    return se3.transform(se3.inverse(T_world_cam), world).T


@pytest.mark.parametrize("with_depth", [True, False])
def test_jacobians_are_those_of_finite_differences(float64, rng, with_depth):
    T, world, (pixels, depth), (sigma, depth_sigma) = scene(rng)

    def found(points):
        return reprojection_residuals(
            camera(),
            points,
            pixels,
            depth if with_depth else None,
            sigma=sigma,
            inverse_depth_sigma=depth_sigma,
        )

    residual = jax.jit(lambda points: found(points).residual)
    points = in_camera(T, world)
    exact, step = jax.jit(found)(points), 1e-6
    assert exact.residual.shape == (3 if with_depth else 2, 7)
    for i, unit in enumerate(step * np.eye(6)):
        ends = [residual(in_camera(se3.compose(T, se3.exp(jnp.asarray(s * unit))), world)) for s in (1, -1)]
        slope = (ends[0] - ends[1]) / (2 * step)
        np.testing.assert_allclose(exact.pose_jacobian[:, i], slope, rtol=1e-6, atol=1e-6)
    for i, unit in enumerate(step * np.eye(3)):
        slope = (residual(points + unit[:, None]) - residual(points - unit[:, None])) / (2 * step)
        np.testing.assert_allclose(exact.point_jacobian[:, i], slope, rtol=1e-6, atol=1e-6)


def test_residuals_are_predicted_minus_measured_in_standard_deviations(float64):
    points = jnp.asarray([[0.2, 0.2, 0.2], [-0.1, -0.1, -0.1], [2.0, 2.0, 2.0]])
    depth = jnp.asarray([4.0, 0.0, jnp.inf])
    found = reprojection_residuals(
        camera(), points, jnp.full((2, 3), 300.0), depth, sigma=2.0, inverse_depth_sigma=0.5
    )
    # The image is at (370, 214.5), and the inverse depth is 0.5, not 0.25.
    np.testing.assert_allclose(found.residual[:2], np.tile([[35.0], [-42.75]], 3))
    np.testing.assert_allclose(found.residual[2], [0.5, 0, 0])
    assert not np.any(found.point_jacobian[2, :, 1:])
    assert np.all(found.has_image)


DEPTHS = [-2.0, -1e-30, 0.0, 1e-30, 0.9 * NEAREST_DEPTH, jnp.nan]


def test_points_without_an_image_cost_and_do_not_pull():
    points = jnp.asarray([[0.1] * len(DEPTHS), [0.2] * len(DEPTHS), DEPTHS])
    lanes = jnp.ones(len(DEPTHS))
    found = reprojection_residuals(
        camera(jnp.float32), points, jnp.ones((2, len(DEPTHS))), lanes, sigma=2.0, inverse_depth_sigma=0.1
    )
    assert not np.any(found.has_image)
    np.testing.assert_array_equal(found.residual, np.array([[320.0], [320.0], [0.0]]) * lanes[None])
    assert not np.any(found.point_jacobian)
    assert not np.any(found.pose_jacobian)


def test_gradients_are_finite_for_points_without_an_image_and_missing_depth():
    points = jnp.asarray([[0.1] * 7, [0.2] * 7, [*DEPTHS, 2.0]])
    depth = jnp.asarray([1.0, 0.0, jnp.nan, -1.0, jnp.inf, 1.0, 0.0])

    @jax.jit
    @jax.grad
    def slope(arguments):
        points, pixels, depth, sigma, camera = arguments
        found = reprojection_residuals(
            camera, points, pixels, depth, sigma=sigma, inverse_depth_sigma=0.01 * sigma
        )
        leaves = found.residual, found.point_jacobian, found.pose_jacobian
        return sum(jnp.sum(leaf**2) for leaf in leaves)

    pulled = slope((points, jnp.ones((2, 7)), depth, jnp.ones(7), camera(jnp.float32)))
    for leaf in jax.tree.leaves(pulled):
        assert np.all(np.isfinite(leaf))
    assert not np.any(pulled[0][:, :6])
    assert np.all(pulled[0][:, 6] != 0)
