"""Direct alignment: poses, gain and offset found by an image, against exact ones."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import Camera
from sfgs_jax.geometry import se3
from sfgs_jax.splatting import RenderOutput, align_image

CAMERA = Camera(130.0, 130.0, 79.5, 59.5, width=160, height=120)


def surface_of(T_world_cam) -> tuple[np.ndarray, np.ndarray]:
    """Colour and depth of a textured corner, two walls and a floor, by intersection of rays; float64."""
    T = np.asarray(se3.matrix(T_world_cam), np.float64)
    u, v = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    rays = np.stack([(u - 79.5) / 130, (v - 59.5) / 130, np.ones_like(u, float)], -1) @ T[:3, :3].T
    planes = [((0.6, 0, 0.8), 2.5), ((-0.8, 0, 0.6), 2.2), ((0, 1, 0), 1.0)]
    distances = []
    for normal, distance in planes:
        along = rays @ np.asarray(normal)
        with np.errstate(divide="ignore"):
            distances.append((distance - T[:3, 3] @ np.asarray(normal)) / along)
    distances = np.where(np.asarray(distances) > 0, distances, np.inf)
    points = T[:3, 3] + rays * np.min(distances, axis=0)[..., None]
    waves = [np.sin(points @ np.asarray(k)) for k in ((9, 3, 2), (-2, 8, 5), (4, -3, 10), (2, 1, 1))]
    grey = 0.5 + 0.1 * np.sum(waves, axis=0)
    return np.repeat(grey[..., None], 3, axis=-1).astype(np.float32), np.min(distances, axis=0)


def rendering_at(T_world_cam, alpha: float = 1.0) -> RenderOutput:
    rgb, depth = surface_of(T_world_cam)
    depth = jnp.asarray(depth, jnp.float32)
    return RenderOutput(
        rgb=jnp.asarray(rgb),
        depth=depth,
        median_depth=depth,
        accumulated_depth=depth,
        alpha=jnp.full(depth.shape, alpha),
        features=None,
        overflow=jnp.asarray(0),
        needed=jnp.asarray(0),
    )


def errors(found, truth) -> tuple[float, float]:
    """Metres and radians between two poses."""
    metres, radians = se3.extent(se3.compose(se3.inverse(truth), found))
    return float(metres), float(radians)


TRUTH = se3.exp(jnp.asarray([0.1, -0.05, 0.2, 0.05, -0.1, 0.02]))
EVERYWHERE = jnp.ones(CAMERA.shape, bool)


@pytest.mark.parametrize("seed", range(5))
def test_two_centimetres_and_a_degree_are_found(seed):
    way = np.random.default_rng(seed).normal(size=(2, 3))
    way *= np.asarray([[0.02], [np.radians(1)]]) / np.linalg.norm(way, axis=1, keepdims=True)
    start = se3.compose(TRUTH, se3.exp(jnp.asarray(way.reshape(6), jnp.float32)))
    image = jnp.asarray(surface_of(TRUTH)[0]) * 0.8 + 0.05
    found = align_image(image, EVERYWHERE, rendering_at(start), CAMERA, start)
    metres, radians = errors(found.T_world_cam, TRUTH)
    assert metres < 0.002
    assert radians < np.radians(0.1)
    np.testing.assert_allclose((found.gain, found.offset), (0.8, 0.05), atol=0.01)
    assert found.rmse < 0.01
    assert found.inlier_fraction > 0.7


def test_what_covers_a_quarter_of_the_image_counts_for_little():
    start = se3.compose(TRUTH, se3.exp(jnp.asarray([0.01, -0.01, 0.01, 0.005, 0.005, -0.005])))
    image = surface_of(TRUTH)[0]
    image[:60, :80] = np.random.default_rng(0).random((60, 80, 1))
    found = align_image(jnp.asarray(image), EVERYWHERE, rendering_at(start), CAMERA, start)
    metres, radians = errors(found.T_world_cam, TRUTH)
    assert metres < 0.004
    assert radians < 0.002


def test_the_information_is_that_of_the_noise():
    """Errors of the pose by white noise have the covariance that the information tells."""
    rendered, rng = rendering_at(TRUTH), np.random.default_rng(0)
    image, squares = surface_of(TRUTH)[0], []
    for _ in range(40):
        noise = rng.normal(0, 0.02, (*CAMERA.shape, 1)).astype(np.float32)
        found = align_image(jnp.asarray(image + noise), EVERYWHERE, rendered, CAMERA, TRUTH)
        error = np.asarray(se3.log(se3.compose(se3.inverse(TRUTH), found.T_world_cam)), np.float64)
        squares.append(error @ np.asarray(found.information, np.float64) @ error)
    assert 3 < np.mean(squares) < 12


def test_nothing_to_see_moves_nothing():
    rendered = rendering_at(TRUTH)
    blank = jnp.full((*CAMERA.shape, 3), 0.5)
    bare = RenderOutput(**{**vars(rendered), "rgb": blank})
    for image, valid, out in (
        (blank, EVERYWHERE, bare),
        (jnp.full_like(blank, jnp.nan), ~EVERYWHERE, rendered),
        (blank, EVERYWHERE, rendering_at(TRUTH, alpha=0.3)),
    ):
        found = align_image(image, valid, out, CAMERA, TRUTH)
        assert errors(found.T_world_cam, TRUTH)[0] < 1e-6
        assert all(bool(jnp.all(jnp.isfinite(leaf))) for leaf in jax.tree.leaves(found))
        assert float(jnp.max(jnp.abs(found.information))) < 1e-3
