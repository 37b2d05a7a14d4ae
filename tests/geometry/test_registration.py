"""Depth registration against a dense loop, and on planes where the answer is known."""

import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.geometry import Camera, register_depth, se3

MARGIN = 1.15
"""Footprints are widened by 15 %."""


def _camera(focal: float, width: int = 48, height: int = 36) -> Camera:
    return Camera(focal, focal * 1.02, width / 2 - 0.3, height / 2 + 0.4, width=width, height=height)


def _register_by_loop(depth, depth_camera, camera, T) -> np.ndarray:
    """The definition: each pixel as a rectangle, nearest depth wins, in float64."""
    fx, fy, cx, cy = (float(x) for x in (camera.fx, camera.fy, camera.cx, camera.cy))
    dfx, dfy = float(depth_camera.fx), float(depth_camera.fy)
    result = np.full(camera.shape, np.inf)
    for v, u in np.argwhere(np.isfinite(depth) & (depth > 0)):
        d = float(depth[v, u])
        ray = [(u - float(depth_camera.cx)) / dfx, (v - float(depth_camera.cy)) / dfy, 1]
        x, y, z = T[:3, :3] @ (np.asarray(ray) * d) + T[:3, 3]
        if z <= 0:
            continue
        pu, pv = fx * x / z + cx, fy * y / z + cy
        half_u, half_v = 0.5 * MARGIN * d / z * fx / dfx, 0.5 * MARGIN * d / z * fy / dfy
        for row in range(camera.height):
            if abs(row - pv) <= half_v:
                for column in range(camera.width):
                    if abs(column - pu) <= half_u:
                        result[row, column] = min(result[row, column], z)
    return np.where(np.isfinite(result), result, 0)


def _motion() -> np.ndarray:
    return np.asarray(se3.matrix(se3.exp(jnp.asarray([-0.06, 0.02, 0.05, 0.02, -0.03, 0.04]))), np.float64)


@pytest.mark.parametrize(("focal", "max_footprint"), [(40.0, 2), (75.0, 3)])
def test_agrees_with_a_loop_over_pixels(rng, focal, max_footprint):
    depth = np.kron(rng.uniform(0.8, 3, (9, 12)), np.ones((4, 4))).astype(np.float32)
    depth += rng.uniform(0, 0.05, depth.shape).astype(np.float32)
    depth[rng.uniform(size=depth.shape) < 0.1] = 0
    depth[3, 5], depth[10, 20], depth[20, 30] = np.nan, np.inf, -1.0
    depth_camera, camera = _camera(45.0), _camera(focal, 50, 30)
    T = _motion()
    got = np.asarray(
        register_depth(
            jnp.asarray(depth), depth_camera, camera, se3.from_matrix(T), max_footprint=max_footprint
        )
    )
    expected = _register_by_loop(depth, depth_camera, camera, T)
    assert 0.3 < (expected > 0).mean() < 1
    # A rectangle's border within rounding of a pixel centre may fall either way.
    agree = np.abs(got - expected) < 1e-5
    assert agree.mean() > 0.995


def test_same_camera_changes_nothing(rng):
    depth = rng.uniform(0.5, 4, (36, 48)).astype(np.float32)
    depth[4:9, 7:11] = 0
    camera = _camera(45.0)
    got = register_depth(jnp.asarray(depth), camera, camera, se3.identity())
    # The margin of 15 % lets no rectangle reach a neighbour's centre.
    np.testing.assert_allclose(np.asarray(got), depth, rtol=1e-6)


def test_slanted_plane_has_no_cracks_and_its_own_depth():
    # The ratio of focal lengths and the shift are the Kinect's; the plane leans by 56 degrees.
    depth_camera, camera = _camera(58.5), _camera(52.5)
    normal, offset = np.asarray([0.8, 0.2, -0.56]), -1.2
    rays = np.asarray(depth_camera.unproject(depth_camera.pixels(), jnp.ones(depth_camera.shape)), np.float64)
    depth = np.clip(offset / (rays @ normal), 0, 4)
    depth[depth == 4] = 0
    T = np.eye(4)
    T[:3, 3] = [-0.025, 0.0, 0.002]
    got = np.asarray(
        register_depth(jnp.asarray(depth, jnp.float32), depth_camera, camera, se3.from_matrix(T))
    )
    expected = (offset + normal @ T[:3, 3]) / (
        np.asarray(camera.unproject(camera.pixels(), jnp.ones(camera.shape)), np.float64) @ normal
    )
    # Away from the image's border and the cut at 4 m, everything is covered.
    inside = (expected > 0) & (expected < 3.2)
    inside[:4], inside[-4:], inside[:, :4], inside[:, -4:] = False, False, False, False
    assert inside.sum() > 300
    assert np.all(got[inside] > 0)
    # A drawn pixel keeps one depth over its width, so it is right to its slope times about a pixel.
    slope = np.abs(np.gradient(expected, axis=1)) + np.abs(np.gradient(expected, axis=0))
    assert np.all(np.abs(got - expected)[inside] <= 1.1 * slope[inside] + 1e-4)


def test_nearer_surface_hides_what_is_behind_it():
    camera = _camera(45.0)
    depth = np.full((36, 48), 3.0, np.float32)
    depth[10:26, 14:30] = 1.0
    T = np.eye(4)
    T[:3, 3] = [0.1, 0.0, 0.0]  # moves the square by 4.5 pixels, the background by 1.5
    got = np.asarray(register_depth(jnp.asarray(depth), camera, camera, se3.from_matrix(T)))
    np.testing.assert_allclose(got[11:25, 20:33], 1.0)  # no background shows through
    assert np.all(got[11:25, 16:18] == 0)  # seen by neither


def test_points_behind_the_other_camera_are_dropped():
    camera = _camera(45.0)
    T = np.eye(4)
    T[2, 3] = -2.0
    got = register_depth(jnp.full((36, 48), 1.5), camera, camera, se3.from_matrix(T))
    assert not np.any(np.asarray(got))


def test_float64(float64, rng):
    depth = jnp.asarray(rng.uniform(1, 2, (36, 48)))
    camera = Camera(*jnp.asarray([45.0, 45.0, 23.5, 17.5]), width=48, height=36)
    got = register_depth(depth, camera, camera, se3.identity(jnp.float64))
    assert got.dtype == jnp.float64
    np.testing.assert_allclose(got, depth, rtol=1e-6)
