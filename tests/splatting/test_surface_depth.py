"""Depth and normals where rays meet the surfaces: a slanted plane, any ellipsoid, and Gaussians on edge."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sfgs_jax.geometry import Camera, se3
from sfgs_jax.splatting import Gaussians, RenderConfig, camera_normals, project, render, unit_normals
from tests.splatting.shapes import covariances

CAMERA = Camera(60.0, 60.0, 29.5, 21.5, width=60, height=44)
CONFIG = RenderConfig(pair_capacity=16_384, surface_depth=True)
NORMAL = np.asarray([0.5, 0.3, -0.812])
NORMAL /= np.linalg.norm(NORMAL)
DISTANCE = 1.6
IDENTITY = se3.identity()


def slanted_plane(seed: int = 0) -> Gaussians:
    """Discs of many sizes and opacities on the plane n . x = -d, which the whole image shows."""
    rng = np.random.default_rng(seed)
    n = 900
    u, v = rng.uniform(-8, 68, n), rng.uniform(-8, 52, n)
    ray = np.stack([(u - 29.5) / 60, (v - 21.5) / 60, np.ones(n)], axis=1)
    means = ray * (-DISTANCE / (ray @ NORMAL))[:, None]
    turn = Rotation.align_vectors([NORMAL], [[0.0, 0, 1]])[0] * Rotation.from_rotvec(
        np.outer(rng.uniform(0, 6, n), [0, 0, 1])
    )
    size = rng.uniform(0.02, 0.12, (n, 2))
    return Gaussians(
        means=jnp.asarray(means, jnp.float32),
        quaternions=jnp.asarray(turn.as_quat(scalar_first=True), jnp.float32),
        log_scales=jnp.asarray(np.log(np.concatenate([size, np.full((n, 1), 1e-4)], axis=1)), jnp.float32),
        opacity_logits=jnp.asarray(rng.normal(0, 2, n), jnp.float32),
        sh=jnp.zeros((n, 1, 3)),
        valid=jnp.ones(n, bool),
    )


def rays() -> np.ndarray:
    u, v = np.meshgrid(np.arange(60.0), np.arange(44.0))
    return np.stack([(u - 29.5) / 60, (v - 21.5) / 60, np.ones_like(u)], axis=-1)


@pytest.fixture(scope="module")
def plane():
    scene = slanted_plane()
    out = render(scene, CAMERA, IDENTITY, features=camera_normals(scene, IDENTITY), config=CONFIG)
    assert int(out.overflow) == 0
    return out


def test_the_depth_of_a_slanted_plane_is_the_planes_at_every_pixel(plane):
    seen = np.asarray(plane.alpha) > 0.2
    assert np.mean(seen) > 0.95
    exact = -DISTANCE / (rays() @ NORMAL)
    at_surface, at_centres = (np.abs(np.asarray(d) - exact)[seen] for d in (plane.surface_depth, plane.depth))
    assert np.sqrt(np.mean(at_surface**2)) < 0.05 * np.sqrt(np.mean(at_centres**2))
    assert np.median(at_surface) < 0.01 * np.median(at_centres)


def test_normals_of_a_plane_are_exact(plane):
    normals = np.asarray(unit_normals(plane.features))
    seen = np.asarray(plane.alpha) > 0.2
    np.testing.assert_allclose(normals[seen], np.broadcast_to(NORMAL, normals[seen].shape), atol=2e-6)
    empty = unit_normals(jnp.zeros((1, 1, 3)))
    np.testing.assert_array_equal(empty, 0)


def test_normals_follow_the_pose_and_face_the_camera():
    scene = slanted_plane()
    behind = np.asarray([0.0, 0, 0.2]) - 4 * NORMAL
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec([0.3, -2.5, 0.2]).as_matrix()
    matrix[:3, 3] = behind
    normals = np.asarray(camera_normals(scene, se3.from_matrix(matrix)))
    expected = -NORMAL @ matrix[:3, :3]
    np.testing.assert_allclose(normals, np.broadcast_to(expected, normals.shape), atol=2e-6)


def test_the_slope_is_where_density_along_the_ray_is_greatest(rng):
    # Ellipsoids with three different axes, of centre m and covariance C. The density along a ray r is
    # greatest at depth (r' C⁻¹ m) / (r' C⁻¹ r).
    n = 40
    scene = Gaussians(
        means=jnp.asarray(rng.uniform([-0.6, -0.4, 1.5], [0.6, 0.4, 3], (n, 3)), jnp.float32),
        quaternions=jnp.asarray(rng.normal(size=(n, 4)), jnp.float32),
        log_scales=jnp.asarray(np.log(rng.uniform(0.08, 0.2, (n, 3))), jnp.float32),
        opacity_logits=jnp.zeros(n),
        sh=jnp.zeros((n, 1, 3)),
        valid=jnp.ones(n, bool),
    )
    projected, _ = project(scene, CAMERA, IDENTITY, config=CONFIG)
    means, inverse = np.asarray(scene.means, np.float64), np.linalg.inv(covariances(scene))

    def inverse_depth(pixels: np.ndarray) -> np.ndarray:
        ray = np.concatenate([(pixels - [29.5, 21.5]) / 60, np.ones((n, 1))], axis=1)
        return np.einsum("ni,nij,nj->n", ray, inverse, ray) / np.einsum("ni,nij,nj->n", ray, inverse, means)

    centres = 60 * means[:, :2] / means[:, 2:] + [29.5, 21.5]
    step = 1e-4 * np.eye(2)
    slopes = np.stack(
        [(inverse_depth(centres + s) - inverse_depth(centres - s)) / 2e-4 for s in step], axis=1
    )
    found = np.asarray(projected.inverse_depth_slopes)
    scale = np.max(np.abs(slopes))
    np.testing.assert_allclose(found, slopes, atol=0.01 * scale)


def test_a_disc_on_edge_puts_nothing_far_from_itself():
    # Seen at 89.9 degrees its plane would reach to infinity within a pixel.
    angle = np.deg2rad(89.9)
    scene = slanted_plane()
    disc = replace(
        scene,
        means=scene.means.at[0].set(jnp.asarray([0.0, 0, 2])),
        quaternions=scene.quaternions.at[0].set(
            jnp.asarray([np.cos(angle / 2), 0, np.sin(angle / 2), 0], jnp.float32)
        ),
        log_scales=scene.log_scales.at[0].set(jnp.log(jnp.asarray([0.1, 0.1, 1e-4]))),
        opacity_logits=scene.opacity_logits.at[0].set(6.0),
        valid=jnp.arange(len(scene.means)) == 0,
    )
    out = render(disc, CAMERA, IDENTITY, features=camera_normals(disc, IDENTITY), config=CONFIG)
    depth = np.asarray(out.surface_depth)[np.asarray(out.alpha) > 0]
    assert len(depth) > 20
    # Twice the 3.33 standard deviations to which a Gaussian is drawn, in inverse depth.
    bound = 2 * 3.33 * 0.1 / 2**2
    assert np.max(np.abs(1 / depth - 0.5)) < 1.001 * bound


def test_it_is_drawn_on_request_only():
    plain = replace(CONFIG, surface_depth=False)
    shapes = jax.eval_shape(lambda: render(slanted_plane(), CAMERA, IDENTITY, config=plain))
    assert shapes.surface_depth is None
    assert shapes.depth.shape == CAMERA.shape
