"""Rendering on devices whose default products are TF32: images, gradients and lists stay right.

Each test also rounds the products that ask for a higher precision, and then must fail: so it would notice.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.geometry import Camera, se3
from sfgs_jax.splatting import Gaussians, bin_into_tiles, project, reference, render, ssim
from tests.splatting.scenes import CONFIG, images_of, make_camera, make_pose, make_scene
from tests.tf32 import at_tf32, default_products

CAMERA = Camera(60.0, 62.0, 31.0, 26.0, width=64, height=53)


def relative_error(actual, expected) -> float:
    """Largest relative error in norm among the leaves."""
    pairs = zip(jax.tree.leaves(actual), jax.tree.leaves(expected), strict=True)
    return max(
        float(np.linalg.norm(np.asarray(a) - np.asarray(b)) / np.linalg.norm(np.asarray(b))) for a, b in pairs
    )


def images_and_gradients(draw):
    """A function of the scene and a motion of the camera: images, and a loss's gradients by both."""

    def evaluate(scene: Gaussians, delta: jax.Array):
        def loss(varied: tuple[Gaussians, jax.Array]):
            scene, delta = varied
            pose = se3.compose(make_pose(), se3.exp(delta))
            image = images_of(draw(scene, make_camera(), pose, config=CONFIG))
            weights = jax.random.normal(jax.random.key(3), image.shape)
            return jnp.sum(image * weights), image

        gradients, image = eqx.filter_grad(loss, has_aux=True)((scene, delta))
        return image, gradients

    return evaluate


@pytest.mark.parametrize("draw", [render, reference.render], ids=["tiles", "oracle"])
def test_images_depths_and_gradients_are_those_of_float32(draw):
    scene, still = make_scene(0, degree=3), jnp.zeros(6)
    evaluate = images_and_gradients(draw)
    assert default_products(evaluate, scene, still) == []
    exact = jax.jit(evaluate)(scene, still)
    assert relative_error(at_tf32(evaluate)(scene, still), exact) < 1e-5
    assert relative_error(at_tf32(evaluate, every=True)(scene, still), exact) > 1e-4


def many_hidden_gaussians() -> Gaussians:
    """Small Gaussians that fill the image, every other thousand of them not in use."""
    rng, n = np.random.default_rng(0), 12_000
    means = np.stack([rng.uniform(-1, 1, n), rng.uniform(-0.8, 0.8, n), rng.uniform(1.5, 2, n)], axis=1)
    return Gaussians(
        means=jnp.asarray(means, jnp.float32),
        quaternions=jnp.ones((n, 4)),
        log_scales=jnp.full((n, 3), -4.5),
        opacity_logits=jnp.zeros(n),
        sh=jnp.zeros((n, 1, 3)),
        valid=jnp.asarray(np.arange(n) // 3000 % 2 == 1),
    )


def test_pairs_are_counted_exactly():
    projected, _ = jax.jit(project)(many_hidden_gaussians(), CAMERA, se3.identity())

    def lists(projected):
        return bin_into_tiles(projected, width=64, height=53, tile_size=8, pair_capacity=16_384)

    exact = jax.jit(lists)(projected)
    assert int(exact.counts.sum()) > 4096
    assert int(exact.overflow) == 0
    rounded = at_tf32(lists)(projected)
    for a, b in zip(jax.tree.leaves(rounded), jax.tree.leaves(exact), strict=True):
        np.testing.assert_array_equal(a, b)
    wrong = at_tf32(lists, every=True)(projected)
    assert not np.array_equal(wrong.counts, exact.counts)


def test_similarity_of_nearly_equal_images_is_that_of_float32(rng):
    image = jnp.asarray(0.5 + 0.02 * rng.random((40, 50, 3)), jnp.float32)
    other = image + jnp.asarray(0.002 * rng.normal(size=image.shape), jnp.float32)
    evaluate = jax.value_and_grad(ssim)
    assert default_products(evaluate, image, other) == []
    exact = jax.jit(evaluate)(image, other)
    assert relative_error(at_tf32(evaluate)(image, other), exact) < 1e-5
    assert relative_error(at_tf32(evaluate, every=True)(image, other), exact) > 1e-3
