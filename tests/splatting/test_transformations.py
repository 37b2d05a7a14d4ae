"""The renderer under jit, vmap, grad, checkpoint and forward mode; and the number of its compilations."""

import re
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.geometry import Camera, se3
from sfgs_jax.splatting import GAUSSIAN_PARAMETERS, Gaussians, render
from tests.splatting.scenes import CONFIG, images_of, make_camera, make_pose, make_scene


def loss(scene, camera, T_world_cam):
    image = images_of(render(scene, camera, T_world_cam, config=CONFIG))
    return jnp.sum(image * jax.random.normal(jax.random.key(3), image.shape))


gradient = jax.value_and_grad(loss, argnums=(0, 1, 2), allow_int=True)
program = jax.jit(gradient)


def assert_same(actual, expected, tolerance=1e-5):
    for a, b in zip(jax.tree.leaves(actual), jax.tree.leaves(expected), strict=True):
        if jnp.issubdtype(b.dtype, jnp.floating):
            np.testing.assert_allclose(a, b, rtol=tolerance, atol=tolerance * float(jnp.max(jnp.abs(b))))


@pytest.fixture
def view():
    return make_scene(14), make_camera(), make_pose()


def test_a_batch_of_cameras_is_a_vmap(view):
    scene, camera, T = view
    cameras = jax.vmap(
        lambda f: Camera(f, f, camera.cx, camera.cy, width=camera.width, height=camera.height)
    )(jnp.asarray([25.0, 30.0, 40.0]))
    tangents = jnp.asarray(np.random.default_rng(0).normal(0, 0.05, (3, 6)), jnp.float32)
    poses = jax.vmap(lambda delta: se3.compose(T, se3.exp(delta)))(tangents)

    def batch_loss(scene, cameras, poses):
        losses = jax.vmap(loss, in_axes=(None, 0, 0))(scene, cameras, poses)
        return jnp.sum(losses), losses

    differentiated = jax.value_and_grad(batch_loss, argnums=(0, 1, 2), allow_int=True, has_aux=True)
    (_, losses), (of_scene, of_cameras, of_poses) = jax.jit(differentiated)(scene, cameras, poses)
    views = [jax.tree.map(lambda x, i=i: x[i], (cameras, poses)) for i in range(3)]
    singles = [program(scene, *view) for view in views]
    assert_same(losses, jnp.stack([value for value, _ in singles]))
    for i, (_, (_, of_camera, of_pose)) in enumerate(singles):
        # Sums over all pixels, part of which cancel.
        batched = jax.tree.map(lambda x, i=i: x[i], (of_cameras, of_poses))
        assert_same(batched, (of_camera, of_pose), tolerance=1e-4)
    assert_same(of_scene.means, sum(of_scene.means for _, (of_scene, _, _) in singles))


def test_a_batch_of_batches_has_the_images_of_its_views(view):
    scene, camera, T = view
    tangents = jnp.asarray(np.random.default_rng(1).normal(0, 0.05, (2, 3, 6)), jnp.float32)

    def image(delta):
        out = render(scene, camera, se3.compose(T, se3.exp(delta)), config=CONFIG)
        return images_of(out), out.median_depth

    batch, medians = jax.jit(jax.vmap(jax.vmap(image)))(tangents)
    for i, j in np.ndindex(2, 3):
        alone, median = jax.jit(image)(tangents[i, j])
        np.testing.assert_array_equal(batch[i, j], alone)
        np.testing.assert_array_equal(medians[i, j], median)


def test_a_batch_of_views_is_composited_at_once(view):
    scene, camera, T = view
    tangents = jnp.zeros((4, 6))

    def image(delta):
        return render(scene, camera, se3.compose(T, se3.exp(delta)), config=CONFIG).rgb

    def loops(function, *arguments):
        return len(re.findall(r"\b(?:while|scan)\[", str(jax.make_jaxpr(function)(*arguments))))

    one, many = loops(image, tangents[0]), loops(jax.vmap(image), tangents)
    assert many == one > 0


def test_filter_grad_takes_a_whole_map(view):
    scene, camera, T = view
    found = eqx.filter_jit(eqx.filter_grad(loss))(scene, camera, T)
    assert isinstance(found, Gaussians)
    assert found.valid is None
    _, (expected, _, _) = program(*view)
    for name in GAUSSIAN_PARAMETERS:
        assert_same(getattr(found, name), getattr(expected, name))
    stepped = eqx.apply_updates(scene, jax.tree.map(lambda slope: -1e-3 * slope, found))
    np.testing.assert_array_equal(stepped.valid, scene.valid)
    assert not np.array_equal(stepped.means, scene.means)


def test_checkpoint_changes_no_gradient(view):
    actual = jax.jit(jax.value_and_grad(jax.checkpoint(loss), argnums=(0, 1, 2), allow_int=True))(*view)
    assert_same(actual, program(*view))


def test_forward_mode_is_refused_in_one_sentence(view):
    scene, camera, T = view

    def moved(step):
        return render(replace(scene, means=scene.means + step), camera, T, config=CONFIG).rgb

    with pytest.raises(TypeError, match=r"render has no forward-mode derivative.*use reverse mode"):
        jax.jvp(moved, (jnp.float32(0),), (jnp.float32(1),))


def test_moved_gaussians_and_cameras_do_not_compile_again(view, compilations):
    scene, camera, T = view
    other = replace(scene, means=scene.means + 0.1, valid=~scene.valid)
    other_camera = Camera(20.0, 21.0, 9.0, 8.0, width=camera.width, height=camera.height)
    other_pose = se3.compose(T, se3.exp(jnp.full(6, 0.01)))
    jax.block_until_ready((render(scene, camera, T, config=CONFIG), program(scene, camera, T)))
    jax.block_until_ready(jax.jit(lambda x: 3 * x + 1)(jnp.ones(3)))
    assert compilations, "the counter must see a program that is new"
    compilations.clear()
    again = render(other, other_camera, other_pose, config=CONFIG), program(other, other_camera, other_pose)
    jax.block_until_ready(again)
    assert not compilations
