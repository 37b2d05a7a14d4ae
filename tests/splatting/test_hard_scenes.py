"""Scenes that break renderers, chosen and random, against the oracle; and lanes that hold NaN."""

from dataclasses import replace
from functools import partial

import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings

from sfgs_jax.geometry import se3
from sfgs_jax.splatting import GAUSSIAN_PARAMETERS, in_sight, pair_capacity, render
from tests.splatting.scenes import (
    CONFIG,
    N,
    assert_close,
    make_camera,
    make_pose,
    make_scene,
    run,
    spoil,
)


def behind(scene, lanes):
    return replace(scene, means=scene.means * jnp.where(lanes[:, None], jnp.asarray([1.0, 1, -1]), 1))


def off_screen(scene, lanes):
    return replace(scene, means=scene.means + jnp.where(lanes[:, None], 50.0, 0))


def needles(scene, lanes):
    needle = jnp.log(jnp.asarray([2.0, 1e-4, 1e-4]))
    return replace(scene, log_scales=jnp.where(lanes[:, None], needle, scene.log_scales))


def covering(scene, lanes):
    return replace(scene, log_scales=scene.log_scales + jnp.where(lanes[:, None], 4.0, 0))


def tiny(scene, lanes):
    return replace(scene, log_scales=jnp.where(lanes[:, None], -18.0, scene.log_scales))


def coincident(scene, lanes):
    return replace(scene, means=jnp.where(lanes[:, None], jnp.asarray([0.1, 0.2, 2.0]), scene.means))


def opaque(scene, lanes):
    return replace(scene, opacity_logits=jnp.where(lanes, 8.0, scene.opacity_logits))


def transparent(scene, lanes):
    return replace(scene, opacity_logits=jnp.where(lanes, -8.0, scene.opacity_logits))


def unused(scene, lanes):
    return replace(scene, valid=scene.valid & ~lanes)


KINDS = [behind, off_screen, needles, covering, tiny, coincident, opaque, transparent, unused]


def assert_agrees_with_the_oracle(seed, mixture):
    """In float64: float32 has no digits left for 1 - alpha behind a wall, or for the conic of a needle."""
    rng = np.random.default_rng(seed)
    with jax.enable_x64(True):
        scene = make_scene(seed, jnp.float64)
        for kind, share in mixture:
            scene = kind(scene, jnp.asarray(rng.random(N) < share))
        assert_close(run("tiles", scene), run("oracle", scene), 1e-7, floor=1e-9)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_scenes_of_one_kind_agree_with_the_oracle(kind):
    assert_agrees_with_the_oracle(8, [(kind, 1)])


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    seed=st.integers(100, 2**16),
    mixture=st.lists(st.tuples(st.sampled_from(KINDS), st.floats(0, 1)), max_size=4),
)
def test_mixed_scenes_agree_with_the_oracle(seed, mixture):
    assert_agrees_with_the_oracle(seed, mixture)


@settings(max_examples=20, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 2**16),
    field=st.sampled_from(tuple(GAUSSIAN_PARAMETERS)),
    value=st.sampled_from([np.nan, np.inf, -np.inf, 0.0, 1e-38, 1e-37, 1e30, -1e30, 100.0, -100.0]),
)
def test_no_parameter_value_makes_a_nan(seed, field, value):
    """Whatever valid Gaussians hold, all images and gradients are finite."""
    scene = make_scene(seed)
    values = getattr(scene, field)
    rows = jnp.arange(N).reshape((-1,) + (1,) * (values.ndim - 1)) % 3 == 0
    scene = replace(scene, **{field: jnp.where(rows, jnp.float32(value), values)})
    for name, result in run("tiles", scene).items():
        assert np.all(np.isfinite(result)), name


def test_no_slots_at_all_show_the_background():
    none = jax.tree.map(lambda values: values[:0], make_scene(0))
    background = jnp.asarray([0.1, 0.2, 0.3])
    assert pair_capacity(none, make_camera(), make_pose()) > 0

    @jax.jit
    @partial(jax.grad, has_aux=True)
    def slope(means):
        out = render(replace(none, means=means), make_camera(), make_pose(), background, config=CONFIG)
        return jnp.sum(out.rgb), out

    gradient, out = slope(none.means)
    assert gradient.shape == (0, 3)
    assert np.all(np.asarray(out.rgb) == np.asarray(background))
    assert np.all(out.alpha == 0)
    assert int(out.overflow) == 0


def test_zero_scales_draw_dots_as_large_as_the_low_pass():
    """log_scales of -inf; the oracle's gradient by them is -inf times 0, and is 0 here."""
    scene = replace(make_scene(8), log_scales=jnp.full((N, 3), -jnp.inf))
    actual, expected = run("tiles", scene), run("oracle", scene)
    assert np.all(actual.pop("log_scales") == 0)
    expected.pop("log_scales")
    assert_close(actual, expected, 1e-4)


def test_a_zero_quaternion_does_not_rotate():
    scene = make_scene(8)
    zero = run("tiles", replace(scene, quaternions=jnp.zeros((N, 4))))
    identity = run("tiles", replace(scene, quaternions=jnp.zeros((N, 4)).at[:, 0].set(1.0)))
    assert np.all(zero.pop("quaternions") == 0)
    identity.pop("quaternions")
    assert_close(zero, identity, 1e-6)


def test_what_masked_lanes_hold_changes_nothing():
    scene = make_scene(9)
    holes = ~np.asarray(scene.valid)
    assert holes.any()
    spoiled, whole = run("tiles", spoil(scene, holes)), run("tiles", scene)
    for a, b in zip(jax.tree.leaves(spoiled), jax.tree.leaves(whole), strict=True):
        np.testing.assert_array_equal(a, b)


def test_far_from_the_origin_renders_the_same():
    scene = make_scene(10)
    # Exactly representable near 1000 m, so that only the renderer could lose digits.
    offset = jnp.asarray([1000.0, -1000.0, 1000.0])
    near_means = jnp.round(scene.means * 2**13) / 2**13
    identity = se3.identity()
    moved = type(identity)(identity.wxyz_xyz.at[4:].set(offset))
    near = run("tiles", replace(scene, means=near_means), identity)
    far = run("tiles", replace(scene, means=near_means + offset[None]), moved)
    np.testing.assert_array_equal(far["image"], near["image"])


@pytest.fixture
def wall_and_room():
    """A scene with every other Gaussian 10 m farther, and a depth before those, known on the left half."""
    scene, camera = make_scene(seed=0), make_camera()
    pose = make_pose()
    forward = np.asarray(se3.matrix(pose))[:3, 2]
    odd = np.arange(N)[:, None] % 2 == 1
    scene = replace(scene, means=scene.means + jnp.where(odd, 10 * forward, 0))
    depth = (np.asarray(scene.means) - np.asarray(pose.translation())) @ forward
    near = depth - 3 * np.exp(np.asarray(scene.log_scales).max(axis=1)) < 5
    assert 10 < near.sum() < N - 10
    between = np.full(camera.shape, 5, np.float32)
    between[:, camera.width // 2 :] = 0
    return scene, near, camera, pose, jnp.asarray(between)


def test_what_a_surface_hides_is_left_out(wall_and_room):
    scene, near, camera, pose, between = wall_and_room
    draw = partial(render, camera=camera, T_world_cam=pose, config=CONFIG)
    found, whole = draw(scene, hidden_beyond=between), draw(scene)
    front = draw(replace(scene, valid=scene.valid & near))
    tiles = camera.width // 2 // CONFIG.tile_size * CONFIG.tile_size  # a tile across the middle hides as well
    np.testing.assert_allclose(found.rgb[:, :tiles], front.rgb[:, :tiles], atol=1e-6)
    tiles += CONFIG.tile_size
    np.testing.assert_allclose(found.rgb[:, tiles:], whole.rgb[:, tiles:], atol=1e-6)
    assert np.abs(whole.rgb - front.rgb)[:, :tiles].max() > 0.01, "there is something to hide"
    assert int(found.needed) < int(whole.needed), "what is hidden needs no room"


def test_each_tile_hides_by_its_own_depth(wall_and_room):
    """A Gaussian on the border of two tiles is drawn in the one that does not hide it."""
    scene, _, camera, pose, _ = wall_and_room
    rows, columns = np.indices(camera.shape) // CONFIG.tile_size
    deep = (rows + columns) % 2 == 1
    draw = partial(render, scene, camera, pose, config=CONFIG)
    found = draw(hidden_beyond=jnp.asarray(np.where(deep, 100, 5).astype(np.float32)))
    shallow = draw(hidden_beyond=jnp.full(camera.shape, 5.0))
    np.testing.assert_allclose(found.rgb, np.where(deep[..., None], draw().rgb, shallow.rgb), atol=1e-6)
    assert np.abs(draw().rgb - shallow.rgb)[deep].max() > 0.01


def test_what_is_hidden_has_no_gradient(wall_and_room):
    scene, near, camera, pose, between = wall_and_room
    everywhere = jnp.full_like(between, between.max())

    def brightness(opacity_logits):
        drawn = replace(scene, opacity_logits=opacity_logits)
        return jnp.sum(render(drawn, camera, pose, hidden_beyond=everywhere, config=CONFIG).rgb)

    slope = np.asarray(jax.grad(brightness)(scene.opacity_logits))
    assert not slope[~near].any()
    assert slope[near].any()


def test_the_gaussians_in_sight_alone_make_the_same_images(wall_and_room):
    scene, near, camera, pose, between = wall_and_room
    small = replace(scene, log_scales=scene.log_scales - 3)
    seen = in_sight(small, camera, pose, hidden_beyond=between, config=CONFIG)
    every = in_sight(small, camera, pose, config=CONFIG)
    assert 0 < seen.sum() < every.sum() < small.valid.sum()
    assert not np.any(seen & ~every)
    assert not np.any(every & ~seen & near), "what lies in front is not hidden"
    draw = partial(render, camera=camera, T_world_cam=pose, config=CONFIG)
    whole, alone = (draw(replace(small, valid=valid)) for valid in (small.valid, every))
    np.testing.assert_array_equal(alone.rgb, whole.rgb)
    hidden, front = (
        draw(replace(small, valid=valid), hidden_beyond=between) for valid in (small.valid, seen)
    )
    np.testing.assert_array_equal(front.rgb, hidden.rgb)
    assert int(front.needed) == int(hidden.needed)
    assert np.abs(whole.rgb - hidden.rgb).max() > 0.01
