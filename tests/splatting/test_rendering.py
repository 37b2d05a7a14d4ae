"""The tile renderer against the dense oracle and finite differences: values and every gradient."""

from dataclasses import fields, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.geometry import Camera, se3
from sfgs_jax.splatting import (
    GAUSSIAN_PARAMETERS,
    Gaussians,
    RenderConfig,
    Renderer,
    pair_capacity,
    project,
    rasterize,
    reference,
    render,
    rgb_to_sh,
)
from tests.splatting.scenes import (
    ANTIALIASED,
    CONFIG,
    HEIGHT,
    WIDTH,
    N,
    assert_close,
    images_of,
    make_camera,
    make_pose,
    make_scene,
    program,
    run,
    variables_of,
)

MODES = pytest.mark.parametrize("config", [CONFIG, ANTIALIASED], ids=["classic", "antialiased"])


@MODES
@pytest.mark.parametrize("seed", range(3))
def test_image_and_gradients_agree_with_the_oracle(seed, config):
    scene = make_scene(seed)
    expected = run("oracle", scene, config=config)
    assert np.mean(np.asarray(expected["image"])[..., 5] > 0.5) > 0.6  # the scene fills the image
    assert_close(run("tiles", scene, config=config), expected, 1e-4)


@pytest.mark.usefixtures("float64")
@MODES
@pytest.mark.parametrize("seed", [4, 5])
def test_agrees_with_the_oracle_in_float64(seed, config):
    scene = make_scene(seed, jnp.float64)
    assert_close(run("tiles", scene, config=config), run("oracle", scene, config=config), 1e-9)


@pytest.mark.usefixtures("float64")
@MODES
def test_gradients_agree_with_finite_differences(config):
    scene = make_scene(6, jnp.float64)
    T_world_cam = make_pose(jnp.float64)
    variables = variables_of(scene, make_camera(dtype=jnp.float64))
    tiles = program("tiles", config, scene.means.dtype)
    counted = jnp.ones((HEIGHT, WIDTH), jnp.float32)
    _, gradients = tiles(variables, scene.valid, T_world_cam, counted)
    leaves, structure = jax.tree.flatten(variables)
    rng = np.random.default_rng(0)
    # Along a random direction through each argument in turn; the step stays clear of the jumps at 1/255.
    for i, (leaf, gradient) in enumerate(zip(leaves, jax.tree.leaves(gradients), strict=True)):
        direction = rng.normal(size=leaf.shape)
        values = []
        for sign in (-1, 1):
            moved = [*leaves[:i], leaf + sign * 1e-8 * direction, *leaves[i + 1 :]]
            values.append(
                tiles(jax.tree.unflatten(structure, moved), scene.valid, T_world_cam, counted)[0][0]
            )
        numerical = float(values[1] - values[0]) / 2e-8
        analytical = float(np.sum(np.asarray(gradient) * direction))
        assert numerical == pytest.approx(analytical, rel=1e-5, abs=3e-5), i


@pytest.mark.parametrize(
    ("width", "height", "tile_size", "degree", "antialiased"),
    [(1, 1, 16, 2, False), (41, 17, 5, 3, True), (641, 3, 8, 0, False), (5, 479, 32, 1, False)],
)
def test_any_size_and_mode(width, height, tile_size, degree, antialiased):
    scene, camera, T = make_scene(11, degree=degree), make_camera(width, height), make_pose()
    config = RenderConfig(tile_size=tile_size, pair_capacity=4096, antialiased=antialiased)
    actual = render(scene, camera, T, config=config)
    expected = eqx.filter_jit(reference.render)(scene, camera, T, config=config)
    assert actual.rgb.shape == (height, width, 3)
    assert_close(images_of(actual), images_of(expected), 1e-4)


def test_colours_and_features_can_be_given():
    scene, camera, T = make_scene(11), make_camera(), make_pose()
    colours, features = jnp.asarray(np.random.default_rng(2).random((N, 3)), jnp.float32), jnp.ones((N, 5))
    out = render(scene, camera, T, None, colours, features, config=CONFIG)
    expected = eqx.filter_jit(reference.render)(scene, camera, T, None, colours, features, config=CONFIG)
    assert_close(images_of(out), images_of(expected), 1e-4)
    assert out.features is not None
    np.testing.assert_allclose(out.features, jnp.stack([out.alpha] * 5, axis=-1), atol=1e-6)
    by_harmonics = render(replace(scene, sh=rgb_to_sh(colours)[:, None]), camera, T, config=CONFIG)
    np.testing.assert_allclose(by_harmonics.rgb, out.rgb, atol=1e-5)

    projected, rgb = project(scene, camera, T)
    raster = rasterize(projected, rgb, width=WIDTH, height=HEIGHT, config=CONFIG)
    plain = render(scene, camera, T, config=CONFIG)
    assert plain.features is None
    np.testing.assert_allclose(raster.accumulated, plain.rgb, atol=1e-6)
    seen = np.asarray(raster.median) >= 0
    median_depth = np.asarray(projected.depths)[np.asarray(raster.median)]
    np.testing.assert_allclose(np.asarray(plain.median_depth)[seen], median_depth[seen], rtol=1e-6)
    assert np.all(np.asarray(plain.median_depth)[~seen] == 0)


def wall(depth: float, opacity: float):
    """One Gaussian that covers the image evenly."""
    return replace(
        make_scene(0),
        means=jnp.zeros((N, 3)).at[:, 2].set(depth),
        log_scales=jnp.full((N, 3), 8.0),
        opacity_logits=jnp.full(N, float(np.log(opacity / (1 - opacity)))),
        valid=jnp.arange(N) == 0,
    )


def test_depths_of_two_walls():
    """Weights 0.4 at 1 m and 0.6 x 0.5 at 3 m: half of the light is lost in the second."""
    first, second = wall(1, 0.4), wall(3, 0.5)
    scene = jax.tree.map(lambda a, b: jnp.concatenate([a[:1], b[:1]]), first, second)
    out = render(scene, make_camera(), se3.identity(), config=CONFIG)
    np.testing.assert_allclose(out.alpha, 0.7, atol=1e-4)
    np.testing.assert_allclose(out.accumulated_depth, 0.4 + 0.9, atol=1e-3)
    np.testing.assert_allclose(out.depth, 1.3 / 0.7, atol=1e-3)
    np.testing.assert_allclose(out.median_depth, 3, atol=1e-6)
    out = render(first, make_camera(), se3.identity(), config=CONFIG)
    np.testing.assert_array_equal(out.median_depth, 0)


def test_gaussians_outside_the_near_and_far_planes_are_not_drawn():
    config = replace(CONFIG, near=1.0, far=2.0)
    for depth, drawn in ((0.99, False), (1.01, True), (1.99, True), (2.01, False)):
        alpha = render(wall(depth, 0.5), make_camera(), se3.identity(), config=config).alpha
        np.testing.assert_allclose(alpha, 0.5 if drawn else 0.0, atol=1e-4)


def test_a_pose_may_be_a_matrix_and_traced():
    scene, matrix = wall(1, 0.5), jnp.eye(4).at[0, 3].set(0.1)
    out = render(scene, make_camera(), matrix, config=CONFIG)
    moved = render(scene, make_camera(), se3.exp(jnp.asarray([0.1, 0, 0, 0, 0, 0])), config=CONFIG)
    np.testing.assert_allclose(out.depth, moved.depth, atol=1e-5)
    shapes = jax.eval_shape(lambda m: render(scene, make_camera(), m, config=CONFIG), matrix)
    assert shapes.depth.shape == out.depth.shape
    # The mask has no gradient, so jax.grad takes the whole map only where integers are allowed.
    by_map = jax.grad(lambda g: render(g, make_camera(), matrix, config=CONFIG).rgb.mean(), allow_int=True)
    slope = jax.eval_shape(by_map, scene)
    assert (slope.means.shape, slope.valid.dtype) == ((N, 3), jax.dtypes.float0)


def test_what_light_passes_shows_the_background():
    out = render(wall(1, 0.25), make_camera(), se3.identity(), jnp.asarray([1.0, 0.5, 0.0]), config=CONFIG)
    black = render(wall(1, 0.25), make_camera(), se3.identity(), config=CONFIG)
    np.testing.assert_allclose(
        out.rgb - black.rgb, jnp.broadcast_to(0.75 * jnp.asarray([1, 0.5, 0]), out.rgb.shape), atol=1e-4
    )


def test_pixel_centres_lie_at_integer_coordinates():
    camera = Camera(20, 20, 12, 7, width=WIDTH, height=HEIGHT)
    dot = replace(
        make_scene(8),
        valid=jnp.arange(N) == 3,
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
    # A renderer finds that room itself, and keeps it.
    renderer = Renderer(CONFIG, headroom=1.0)
    out = renderer(scene, camera, se3.matrix(T))
    assert renderer.config == replace(CONFIG, pair_capacity=capacity)
    np.testing.assert_allclose(out.rgb, full.rgb, atol=1e-5)
    renderer.config = replace(CONFIG, pair_capacity=512)
    assert int(renderer(scene, camera, T).overflow) == 0
    assert renderer.config.pair_capacity == capacity
    assert renderer.make_room(wall(1, 0.5), camera, T).pair_capacity == capacity
    with pytest.raises(InputError, match="inside jit or grad use render"):
        jax.eval_shape(lambda scene: renderer(scene, camera, T).rgb, scene)
    with pytest.raises(InputError, match=r"at least 1, not 0\.5"):
        Renderer(headroom=0.5)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ({"near": 2.0, "far": 1.0}, "near must be below far"),
        ({"near": 0.0}, "near must be a finite number above 0"),
        ({"tile_size": 0}, "tile_size must be a whole number of at least 1"),
        ({"pair_capacity": 0}, "pair_capacity must be a whole number of at least 1"),
    ],
)
def test_settings_out_of_range_are_refused(setting, words):
    with pytest.raises(InputError, match=words):
        RenderConfig(**setting)


def test_the_list_of_parameters_is_that_of_the_class():
    scene = make_scene(0, degree=0)
    assert [*GAUSSIAN_PARAMETERS, "valid"] == [field.name for field in fields(Gaussians)]
    assert {name: getattr(scene, name).shape[1:] for name in GAUSSIAN_PARAMETERS} == GAUSSIAN_PARAMETERS


def test_bad_input_is_refused():
    scene, camera, T = make_scene(0), make_camera(), make_pose()
    with pytest.raises(InputError, match="5 coefficients"):
        render(replace(scene, sh=jnp.zeros((N, 5, 3))), camera, T)
    with pytest.raises(InputError, match="need one row each"):
        render(scene, camera, T, None, None, jnp.zeros((N - 1, 3)))
    with pytest.raises(InputError, match="colours have shape"):
        render(scene, camera, T, None, jnp.zeros((N - 1, 3)))
