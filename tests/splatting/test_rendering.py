"""The tile renderer against the dense oracle: values, every gradient, and scenes that break renderers."""

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.geometry import Camera, se3
from sfgs_jax.splatting import Gaussians, RenderConfig, pair_capacity, reference, render

WIDTH, HEIGHT, N = 37, 29, 60
CONFIG = RenderConfig(pair_capacity=4096)


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


def loss(draw, variables, valid, T_world_cam):
    """A scalar that depends on every pixel of every output, each differently."""
    fields, camera, delta, background = variables
    T = se3.compose(T_world_cam, se3.exp(delta))
    out = draw(Gaussians(**fields, valid=valid), camera, T, background, config=CONFIG)
    images = [out.rgb, out.depth[..., None], out.alpha[..., None], out.accumulated_depth[..., None]]
    image = jnp.concatenate(images, axis=-1)
    return jnp.sum(image * jax.random.normal(jax.random.key(7), image.shape, image.dtype)), image


programs = {
    name: jax.jit(jax.value_and_grad(partial(loss, draw), has_aux=True))
    for name, draw in (("tiles", render), ("oracle", reference.render))
}


def variables_of(scene: Gaussians, camera: Camera):
    names = ("means", "quaternions", "log_scales", "opacity_logits", "sh")
    dtype = scene.means.dtype
    background = jnp.asarray([0.2, 0.4, 0.6], dtype)
    return {name: getattr(scene, name) for name in names}, camera, jnp.zeros(6, dtype), background


def run(name: str, scene: Gaussians, T_world_cam=None):
    """Image and gradients by one of the programs."""
    dtype = scene.means.dtype
    T_world_cam = make_pose(dtype) if T_world_cam is None else T_world_cam
    (_, image), gradients = programs[name](
        variables_of(scene, make_camera(dtype=dtype)), scene.valid, T_world_cam
    )
    fields, camera, delta, background = gradients
    # One intrinsic's gradient can be a small difference of large ones; all four are compared as one.
    intrinsics = jnp.stack(jax.tree.leaves(camera))
    return {"image": image, **fields, "intrinsics": intrinsics, "delta": delta, "background": background}


def assert_close(actual, expected, tolerance: float) -> None:
    """Every leaf finite, with a small relative error and the same direction."""
    expected_leaves = jax.tree_util.tree_leaves_with_path(expected)
    for (path, b), a in zip(expected_leaves, jax.tree.leaves(actual), strict=True):
        name = jax.tree_util.keystr(path)
        a, b = np.asarray(a, np.float64).ravel(), np.asarray(b, np.float64).ravel()
        assert np.all(np.isfinite(a)), f"{name} is not finite"
        size = np.linalg.norm(b)
        error = np.linalg.norm(a - b)
        assert error <= tolerance * size + 1e-12, f"{name}: error {error:.2e} of {size:.2e}"
        assert a @ b >= (1 - 1e-4) * np.linalg.norm(a) * size, f"{name}: other direction"


@pytest.mark.parametrize("seed", range(4))
def test_image_and_gradients_agree_with_the_oracle(seed):
    scene = make_scene(seed)
    expected = run("oracle", scene)
    assert np.mean(np.asarray(expected["image"])[..., 4] > 0.5) > 0.6  # the scene fills the image
    assert_close(run("tiles", scene), expected, 1e-4)


@pytest.mark.usefixtures("float64")
@pytest.mark.parametrize("seed", [4, 5])
def test_agrees_with_the_oracle_in_float64(seed):
    scene = make_scene(seed, jnp.float64)
    assert_close(run("tiles", scene), run("oracle", scene), 1e-9)


@pytest.mark.usefixtures("float64")
def test_gradients_agree_with_finite_differences():
    scene = make_scene(6, jnp.float64)
    T_world_cam = make_pose(jnp.float64)
    variables = variables_of(scene, make_camera(dtype=jnp.float64))
    program = programs["tiles"]
    _, gradients = program(variables, scene.valid, T_world_cam)
    leaves, structure = jax.tree.flatten(variables)
    rng = np.random.default_rng(0)
    # Along a random direction through each argument in turn; the step stays clear of the jumps at 1/255.
    for i, (leaf, gradient) in enumerate(zip(leaves, jax.tree.leaves(gradients), strict=True)):
        direction = rng.normal(size=leaf.shape)
        values = []
        for sign in (-1, 1):
            moved = [*leaves[:i], leaf + sign * 1e-8 * direction, *leaves[i + 1 :]]
            values.append(program(jax.tree.unflatten(structure, moved), scene.valid, T_world_cam)[0][0])
        numerical = float(values[1] - values[0]) / 2e-8
        analytical = float(np.sum(np.asarray(gradient) * direction))
        assert numerical == pytest.approx(analytical, rel=1e-5, abs=1e-5), i


def edited(seed: int = 8, **fields) -> Gaussians:
    return replace(make_scene(seed), **{name: jnp.asarray(value) for name, value in fields.items()})


def field(name: str, seed: int = 8) -> np.ndarray:
    return np.array(getattr(make_scene(seed), name))


def needles() -> Gaussians:
    scales = field("log_scales")
    scales[:, 0], scales[:, 1:] = np.log(2.0), np.log(1e-4)
    return edited(log_scales=scales)


def coincident() -> Gaussians:
    means = field("means")
    means[::2] = [0.1, 0.2, 2.0]
    return edited(means=means)


SCENES = {
    "behind the camera": lambda: edited(means=field("means") * [1, 1, -1]),
    "off screen": lambda: edited(means=field("means") + 50),
    "needles": needles,
    "covering the image": lambda: edited(log_scales=field("log_scales") + 4),
    "zero size": lambda: edited(log_scales=np.full((N, 3), -np.inf, np.float32)),
    "coincident in depth": coincident,
    "none valid": lambda: edited(valid=np.zeros(N, bool)),
    "opaque": lambda: edited(opacity_logits=np.full(N, 5, np.float32)),
}


@pytest.mark.parametrize("kind", SCENES)
def test_hard_scenes_agree_with_the_oracle(kind):
    scene = SCENES[kind]()
    # A needle's conic is ill-conditioned in float32: there the oracle, which forms it, is the worse one.
    tolerance = 2e-3 if kind == "needles" else 1e-4
    actual, expected = run("tiles", scene), run("oracle", scene)
    if kind == "zero size":
        # The scale's derivative is exactly 0 there, and the oracle's only up to -inf times 0.
        actual.pop("log_scales"), expected.pop("log_scales")
    assert_close(actual, expected, tolerance)


def test_what_masked_lanes_hold_changes_nothing():
    scene = make_scene(9)
    hole = ~np.asarray(scene.valid)
    assert hole.any()
    spoiled = replace(
        scene,
        **{
            name: jnp.where(
                hole.reshape((-1,) + (1,) * (getattr(scene, name).ndim - 1)), jnp.nan, getattr(scene, name)
            )
            for name in ("means", "quaternions", "log_scales", "opacity_logits", "sh")
        },
    )
    for a, b in zip(
        jax.tree.leaves(run("tiles", spoiled)), jax.tree.leaves(run("tiles", scene)), strict=True
    ):
        np.testing.assert_array_equal(a, b)


def test_far_from_the_origin_renders_the_same():
    scene = make_scene(10)
    # Exactly representable near 1000 m, so that only the renderer could lose digits.
    offset = jnp.asarray([1000.0, -1000.0, 1000.0])
    near_means = jnp.round(scene.means * 2**13) / 2**13
    identity = se3.identity()
    moved = type(identity)(identity.wxyz_xyz.at[4:].set(offset))
    near = run("tiles", replace(scene, means=near_means), identity)
    far = run("tiles", replace(scene, means=near_means + offset), moved)
    np.testing.assert_array_equal(far["image"], near["image"])


@pytest.mark.parametrize(
    ("width", "height", "tile_size", "degree", "antialiased"),
    [(1, 1, 16, 2, False), (41, 17, 5, 3, True)],
)
def test_any_size_and_mode(width, height, tile_size, degree, antialiased):
    scene, camera, T = make_scene(11, degree=degree), make_camera(width, height), make_pose()
    config = RenderConfig(tile_size=tile_size, pair_capacity=4096, antialiased=antialiased)
    actual = render(scene, camera, T, config=config)
    expected = eqx.filter_jit(reference.render)(scene, camera, T, config=config)
    assert actual.rgb.shape == (height, width, 3)
    assert_close(actual, expected, 1e-4)


def test_pixel_centres_lie_at_integer_coordinates():
    camera = Camera(20, 20, 12, 7, width=WIDTH, height=HEIGHT)
    dot = replace(
        edited(valid=np.arange(N) == 3),
        means=jnp.zeros((N, 3)).at[:, 2].set(2.0),
        opacity_logits=jnp.full(N, 3.0),
        log_scales=jnp.full((N, 3), -5.0),
    )
    alpha = np.asarray(render(dot, camera, se3.identity(), config=CONFIG).alpha)
    assert np.unravel_index(alpha.argmax(), alpha.shape) == (7, 12)
    np.testing.assert_allclose(alpha[7, 11], alpha[7, 13], rtol=1e-5)
    np.testing.assert_allclose(alpha[6, 12], alpha[8, 12], rtol=1e-5)


def test_too_little_room_is_reported_and_the_stated_capacity_suffices():
    scene, camera, T = make_scene(12), make_camera(), make_pose()
    scene = replace(scene, log_scales=scene.log_scales + 3)
    full = render(scene, camera, T, config=CONFIG)
    assert int(full.overflow) == 0
    capacity = pair_capacity(scene, camera, T, config=CONFIG)
    assert capacity < CONFIG.pair_capacity
    fitted = render(scene, camera, T, config=replace(CONFIG, pair_capacity=capacity))
    assert int(fitted.overflow) == 0
    np.testing.assert_array_equal(fitted.rgb, full.rgb)
    small = render(scene, camera, T, config=replace(CONFIG, pair_capacity=512))
    assert int(small.overflow) > 0
    assert np.all(np.isfinite(small.rgb))


def test_moved_gaussians_do_not_compile_again(caplog):
    scene, camera, T = make_scene(13), make_camera(), make_pose()
    render(scene, camera, T, config=CONFIG)
    with jax.log_compiles(), caplog.at_level("WARNING", logger="jax"):
        render(replace(scene, means=scene.means + 1, valid=~scene.valid), camera, T, config=CONFIG)
    assert "_render" not in caplog.text


def test_settings_that_make_no_sense_are_refused():
    with pytest.raises(ValueError, match="near < far"):
        RenderConfig(near=2.0, far=1.0)
