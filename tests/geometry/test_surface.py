"""Window moments of depth images: planes, spheres, holes, edges."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.geometry import Camera, surface

CAMERA = Camera(120.0, 110.0, 47.0, 35.5, width=96, height=72)


def rays() -> np.ndarray:
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width].astype(np.float64)
    return np.stack([(u - 47.0) / 120.0, (v - 35.5) / 110.0, np.ones_like(u)], -1)


def plane(normal, distance: float) -> np.ndarray:
    """Depth of the plane normal . X = distance."""
    return (distance / (rays() @ np.asarray(normal, np.float64))).astype(np.float32)


def sphere(centre, radius: float) -> np.ndarray:
    r, c = rays(), np.asarray(centre, np.float64)
    a, b = (r**2).sum(-1), r @ c
    root = b**2 - a * (c @ c - radius**2)
    return np.where(root > 0, (b - np.sqrt(np.maximum(root, 0))) / a, 0).astype(np.float32)


def unit(vector) -> np.ndarray:
    return np.asarray(vector) / np.linalg.norm(vector)


def test_a_plane_gives_its_points_normal_and_flat_covariances():
    normal = unit([0.3, -0.2, -0.9])
    depth = plane(normal, -5.0)
    s = surface(depth, CAMERA, radius=2)
    assert np.all(s.valid[1:-1, 1:-1])
    np.testing.assert_allclose(
        s.normals[s.valid], np.broadcast_to(normal, (int(s.valid.sum()), 3)), atol=2e-4
    )
    np.testing.assert_allclose(s.points[..., 2][s.valid], depth[s.valid], rtol=1e-5)
    values = np.linalg.eigvalsh(np.asarray(s.covariances, np.float64)[5:-5, 5:-5])
    # Across the plane the window's spread is some centimetres; along its normal, float32 leaves microns.
    assert np.sqrt(values[..., 1].min()) > 0.04
    assert np.sqrt(np.abs(values[..., 0]).max()) < 2e-4


def test_the_covariance_is_that_of_the_windows_points():
    s = surface(sphere([0.1, 0.0, 2.0], 0.8), CAMERA, radius=2)
    points = np.asarray(CAMERA.unproject(CAMERA.pixels(), jnp.asarray(sphere([0.1, 0.0, 2.0], 0.8))))
    for row, column in [(36, 47), (30, 60), (44, 38)]:
        window = points[row - 2 : row + 3, column - 2 : column + 3].reshape(-1, 3).astype(np.float64)
        expected = np.cov(window.T, bias=True)
        np.testing.assert_allclose(s.covariances[row, column], expected, atol=0.03 * np.abs(expected).max())


def test_a_spheres_normals_point_outwards():
    centre = np.asarray([0.1, 0.0, 2.0])
    s = surface(sphere(centre, 0.8), CAMERA, radius=2)
    outward = np.asarray(s.points)[s.valid] - centre
    outward /= np.linalg.norm(outward, axis=-1, keepdims=True)
    cosines = np.sum(outward * np.asarray(s.normals)[s.valid], axis=-1)
    assert s.valid.sum() > 1500
    assert np.median(cosines) > 0.9999
    assert cosines.min() > 0.99


def test_normals_face_the_camera():
    s = surface(sphere([0.1, 0.0, 2.0], 0.8), CAMERA, radius=2)
    assert np.all(np.sum(np.asarray(s.points * s.normals), axis=-1)[s.valid] < 0)


def test_holes_leave_the_rest_of_a_plane_right(rng):
    normal = unit([0.1, 0.4, -0.9])
    depth = plane(normal, -3.0)
    missing = rng.random(depth.shape) < 0.25
    depth[missing] = np.where(rng.random(missing.sum()) < 0.5, 0, np.nan)
    s = surface(depth, CAMERA, radius=2)
    valid = np.asarray(s.valid)
    assert not valid[missing].any()
    assert valid.mean() > 0.65
    np.testing.assert_allclose(np.asarray(s.normals)[valid] @ normal, 1, atol=1e-5)
    for leaf in (s.points, s.normals, s.covariances):
        assert np.all(np.isfinite(leaf))
        assert not np.any(np.asarray(leaf)[~valid])


def test_windows_across_a_depth_edge_are_rejected_and_those_beside_it_are_not():
    depth = np.where(np.arange(96) < 48, 1.5, 2.0) * np.ones((72, 1))
    s = surface(depth.astype(np.float32), CAMERA, radius=2)
    assert not s.valid[:, 46:50].any()
    assert s.valid[10:-10, 10:46].all()
    assert s.valid[10:-10, 50:-10].all()


def test_a_larger_window_averages_quantised_depth():
    normal = unit([0.2, 0.1, -1.0])
    inverse = np.round(1 / plane(normal, -2.0).astype(np.float64) / 0.00285) * 0.00285
    errors = []
    for radius in (2, 6):
        s = surface((1 / inverse).astype(np.float32), CAMERA, radius=radius)
        cosines = np.clip(np.asarray(s.normals)[s.valid] @ normal, -1, 1)
        errors.append(np.degrees(np.arccos(cosines)).mean())
    assert errors[1] < errors[0] / 3
    assert errors[1] < 1.0


def test_no_depth_gives_nothing_and_no_nan():
    s = surface(np.full(CAMERA.shape, np.nan, np.float32), CAMERA, radius=2)
    assert not s.valid.any()
    for leaf in (s.points, s.normals, s.covariances):
        assert not np.any(leaf)


def test_gradients_are_finite_where_depth_is_missing_and_right_where_it_is_not():
    depth = plane(unit([0.2, 0.0, -1.0]), -2.0)
    depth[20:30, 20:30] = 0

    @jax.jit
    def mean_depth(d):
        return jnp.sum(surface(d, CAMERA, radius=2).points[50, 50:52, 2])

    gradient = jax.grad(mean_depth)(jnp.asarray(depth))
    assert np.all(np.isfinite(gradient))
    assert not np.any(gradient[20:30, 20:30])
    np.testing.assert_allclose(jnp.sum(gradient), 2.0, rtol=0.01)  # all depths farther: points as much


def test_float64_agrees_with_float32(float64):
    depth = sphere([0.1, 0.0, 2.0], 0.8)
    single = surface(jnp.asarray(depth), Camera(*map(jnp.float32, (120, 110, 47, 35.5)), width=96, height=72))
    double = surface(jnp.asarray(depth, jnp.float64), camera_64())
    assert double.points.dtype == jnp.float64
    both = np.asarray(single.valid & double.valid)
    assert both.sum() > 1500
    np.testing.assert_allclose(np.asarray(single.normals)[both], np.asarray(double.normals)[both], atol=1e-3)
    scale = np.abs(double.covariances).max()
    np.testing.assert_allclose(single.covariances[both], double.covariances[both], atol=1e-4 * scale)


def camera_64() -> Camera:
    return Camera(*(jnp.asarray(x, jnp.float64) for x in (120, 110, 47, 35.5)), width=96, height=72)


def test_bad_input_is_refused():
    with pytest.raises(InputError, match="its camera is"):
        surface(jnp.ones((10, 10)), CAMERA)
    with pytest.raises(InputError, match="radius of at least 1"):
        surface(jnp.ones(CAMERA.shape), CAMERA, radius=0)
