"""Random scenes, and a loss through every image of a rendering, by the tiles and by the oracle."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np

from sfgs_jax.geometry import Camera, se3
from sfgs_jax.splatting import GAUSSIAN_PARAMETERS, Gaussians, RenderConfig, reference, render

WIDTH, HEIGHT, N = 37, 29, 60
CONFIG = RenderConfig(pair_capacity=4096)
ANTIALIASED = replace(CONFIG, antialiased=True, surface_depth=True)
"""Everything that is drawn on request only."""
EXACT = {"xla_backend_optimization_level": "1"}
"""Level 0, which `make test` sets, costs float64 its last digits."""


def make_scene(seed: int, dtype=jnp.float32, degree: int = 1) -> Gaussians:
    """Gaussians of every kind in front of, beside and behind the camera of `make_camera`."""
    rng = np.random.default_rng(seed)
    means = np.stack([rng.uniform(-1.6, 1.6, N), rng.uniform(-1.3, 1.3, N), rng.uniform(0.6, 4, N)], 1)
    means[: N // 10, 2] *= -1
    return Gaussians(
        means=jnp.asarray(means, dtype),
        quaternions=jnp.asarray(rng.normal(size=(N, 4)) * rng.uniform(0.1, 3, (N, 1)), dtype),
        log_scales=jnp.asarray(rng.uniform(np.log(0.03), np.log(0.8), (N, 3)), dtype),
        opacity_logits=jnp.asarray(rng.normal(0.5, 2, N), dtype),
        sh=jnp.asarray(rng.normal(0, 0.4, (N, (degree + 1) ** 2, 3)), dtype),
        valid=jnp.asarray(rng.uniform(size=N) > 0.1),
    )


def make_camera(width: int = WIDTH, height: int = HEIGHT, dtype=jnp.float32) -> Camera:
    values = (0.9 * width, 1.0 * width, 0.48 * width, 0.53 * height)
    return Camera(*(jnp.asarray(value, dtype) for value in values), width=width, height=height)


def make_pose(dtype=jnp.float32):
    return se3.exp(jnp.asarray([0.1, -0.05, 0.08, 0.05, -0.1, 0.2], dtype))


def images_of(out) -> jax.Array:
    """Every image of a rendering, as the channels of one."""
    single = [out.depth, out.median_depth, out.alpha, out.accumulated_depth]
    if out.surface_depth is not None:
        single.append(out.surface_depth)
    images = [out.rgb, *(image[..., None] for image in single)]
    return jnp.concatenate(images if out.features is None else [*images, out.features], axis=-1)


def loss(draw, config, variables, valid, T_world_cam, counted):
    """A scalar that depends on every `counted` pixel of every image, each differently."""
    fields, camera, delta, background, features = variables
    T = se3.compose(T_world_cam, se3.exp(delta))
    scene = Gaussians(**fields, valid=valid)
    image = images_of(draw(scene, camera, T, background, None, features, config=config))
    weights = jax.random.normal(jax.random.key(7), image.shape, jnp.float32).astype(image.dtype)
    return jnp.sum(image * weights * counted[..., None].astype(image.dtype)), image


@cache
def program(name: str, config: RenderConfig, dtype: jnp.dtype) -> Callable:
    """Loss, image and gradients in a type, drawn by `tiles` or by the `oracle`."""
    draw = {"tiles": render, "oracle": reference.render}[name]
    options = EXACT if dtype == jnp.float64 else None
    return jax.jit(jax.value_and_grad(partial(loss, draw, config), has_aux=True), compiler_options=options)


def variables_of(scene: Gaussians, camera: Camera):
    """Arguments of the loss's gradient: parameters, intrinsics, pose, background and features."""
    dtype = scene.means.dtype
    background = jnp.asarray([0.2, 0.4, 0.6], dtype)
    features = jnp.asarray(np.random.default_rng(1).normal(size=(len(scene.means), 2)), dtype)
    parameters = {name: getattr(scene, name) for name in GAUSSIAN_PARAMETERS}
    return parameters, camera, jnp.zeros(6, dtype), background, features


def run(
    name: str,
    scene: Gaussians,
    T_world_cam=None,
    config: RenderConfig = CONFIG,
    camera: Camera | None = None,
    counted=None,
):
    """Image and gradients by one of the programs; the loss is of the pixels `counted`, or of all."""
    dtype = scene.means.dtype
    T_world_cam = make_pose(dtype) if T_world_cam is None else T_world_cam
    camera = make_camera(dtype=dtype) if camera is None else camera
    counted = jnp.ones((camera.height, camera.width), jnp.float32) if counted is None else counted
    variables = variables_of(scene, camera)
    (_, image), gradients = program(name, config, dtype)(variables, scene.valid, T_world_cam, counted)
    parameters, camera, delta, background, features = gradients
    # One intrinsic's gradient can be a small difference of large ones; all four are compared as one.
    intrinsics = jnp.stack(jax.tree.leaves(camera))
    return {
        "image": image,
        **parameters,
        "intrinsics": intrinsics,
        "delta": delta,
        "background": background,
        "features": features,
    }


def assert_close(actual, expected, tolerance: float, floor: float = 1e-12) -> None:
    """Every leaf finite, with a small relative error and the same direction; `floor` is what counts as 0."""
    expected_leaves = jax.tree_util.tree_leaves_with_path(expected)
    for (path, b), a in zip(expected_leaves, jax.tree.leaves(actual), strict=True):
        name = jax.tree_util.keystr(path)
        a, b = np.asarray(a, np.float64).ravel(), np.asarray(b, np.float64).ravel()
        assert np.all(np.isfinite(a)), f"{name} is not finite"
        size = np.linalg.norm(b)
        error = np.linalg.norm(a - b)
        assert error <= tolerance * size + floor, f"{name}: error {error:.2e} of {size:.2e}"
        assert error <= floor or a @ b >= (1 - 1e-4) * np.linalg.norm(a) * size, f"{name}: other direction"


def spoil(scene: Gaussians, lanes: np.ndarray) -> Gaussians:
    """The scene with NaN in all parameters of some Gaussians."""

    def spoiled(values):
        return jnp.where(lanes.reshape((-1,) + (1,) * (values.ndim - 1)), jnp.nan, values)

    return replace(scene, **{name: spoiled(getattr(scene, name)) for name in GAUSSIAN_PARAMETERS})
