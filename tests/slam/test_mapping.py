"""The map: seeds on the surface, optimisation that helps, slots that are used again."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import Camera, slam
from sfgs_jax.evaluation import psnr
from sfgs_jax.geometry import se3
from sfgs_jax.slam.gaussian_map import grow
from sfgs_jax.slam.optimisation import prune
from sfgs_jax.slam.seeding import seed
from sfgs_jax.slam.step import optimise_once
from sfgs_jax.splatting import RenderConfig, render


@pytest.fixture
def seeded(room, frames, config):
    """A state whose map was seeded from one frame and not optimised."""
    bare = replace(config, mapping=replace(config.mapping, steps_per_frame=0, steps_per_keyframe=0))
    return slam.step(slam.init(room.camera, bare), frames[0])[0]


def render_psnr(state, frame):
    out = render(
        state.map.gaussians, state.camera, state.T_world_cam, config=RenderConfig(pair_capacity=32_768)
    )
    return float(psnr(out.rgb, jnp.asarray(frame.rgb)))


def test_seeds_lie_on_the_surface_and_show_its_colours(seeded, frames):
    gaussians = seeded.map.gaussians
    means = np.asarray(gaussians.means[gaussians.valid])
    pixels = np.asarray(seeded.camera.project(jnp.asarray(means)))
    depth = frames[0].depth[np.round(pixels[:, 1]).astype(int), np.round(pixels[:, 0]).astype(int)]
    assert np.median(np.abs(means[:, 2] - depth) / depth) < 0.01
    assert render_psnr(seeded, frames[0]) > 17


def test_a_view_the_map_covers_adds_almost_nothing(seeded, frames, config):
    before = int(jnp.sum(seeded.map.gaussians.valid))
    every = replace(
        seeded, config=replace(seeded.config, mapping=replace(seeded.config.mapping, keyframe_interval=1))
    )
    after, info = slam.step(every, frames[0])
    assert info.new_keyframe
    assert int(jnp.sum(after.map.gaussians.valid)) - before < 0.1 * before


def test_optimisation_brings_the_rendering_closer(seeded, frames):
    before = render_psnr(seeded, frames[0])
    state, losses = seeded, []
    for _ in range(30):
        state, loss = optimise_once(state)
        losses.append(loss)
    assert losses[-1] < 0.75 * losses[0]
    assert render_psnr(state, frames[0]) > before + 1.5


def test_gaussians_out_of_view_keep_their_place_and_their_moments(seeded):
    behind = seeded.map.gaussians.means.at[0].set(jnp.asarray([0.0, 0.0, -2.0]))
    state = eqx.tree_at(lambda s: s.map.gaussians.means, seeded, behind)
    for _ in range(3):
        state, _ = optimise_once(state)
    np.testing.assert_array_equal(state.map.gaussians.means[0], [0.0, 0.0, -2.0])
    assert state.map.updates[0] == 0
    assert jnp.max(state.map.updates) == 3


def test_unused_slots_never_matter(seeded):
    nan = jnp.where(seeded.map.gaussians.valid[:, None], seeded.map.gaussians.means, jnp.nan)
    state, loss = optimise_once(eqx.tree_at(lambda s: s.map.gaussians.means, seeded, nan))
    clean, clean_loss = optimise_once(seeded)
    used = np.asarray(seeded.map.gaussians.valid)
    assert loss == pytest.approx(clean_loss)
    np.testing.assert_allclose(state.map.gaussians.means[used], clean.map.gaussians.means[used])


def test_pruned_slots_are_filled_again(seeded, frames, config):
    valid = np.asarray(seeded.map.gaussians.valid)
    faint = jnp.where(jnp.arange(valid.size) < 300, -10.0, seeded.map.gaussians.opacity_logits)
    broken = seeded.map.gaussians.means.at[300].set(jnp.nan)
    changed = eqx.tree_at(
        lambda m: (m.gaussians.opacity_logits, m.gaussians.means), seeded.map, (faint, broken)
    )
    pruned = prune(changed, 0.02)
    assert int(valid.sum()) - int(jnp.sum(pruned.gaussians.valid)) == 301
    assert not jnp.any(pruned.gaussians.valid[:301])

    keyframe = seeded.keyframes[0]
    everywhere = jnp.ones(keyframe.depth.shape, bool)
    rgb = keyframe.rgb.astype(jnp.float32) / 255
    refilled, dropped = seed(
        pruned,
        rgb,
        keyframe.depth,
        everywhere,
        seeded.mapping_camera,
        keyframe.T_world_cam,
        config.mapping.seeding,
    )
    assert int(dropped) == 0
    assert jnp.all(refilled.gaussians.valid[:301])
    assert jnp.all(jnp.isfinite(refilled.gaussians.means))
    assert jnp.all(refilled.updates[:301] == 0)


def test_growing_keeps_every_gaussian(seeded):
    larger = grow(seeded.map)
    size = seeded.map.gaussians.valid.shape[0]
    assert larger.gaussians.valid.shape[0] == 2 * size
    np.testing.assert_array_equal(larger.gaussians.means[:size], seeded.map.gaussians.means)
    assert not jnp.any(larger.gaussians.valid[size:])


def test_seeds_of_a_slanted_plane_cover_it(config):
    """Spacing down the slope is wider by the cosine, and the Gaussians stretch to fill it."""
    camera = Camera(80.0, 80.0, 47.5, 35.5, width=96, height=72)
    u = camera.pixels()[..., 0]
    depth = 2.0 / (1 - 1.0 * (u - camera.cx) / camera.fx)
    rgb = jnp.full((*camera.shape, 3), 0.5)
    state = slam.init(camera, config)
    seeded, _ = seed(
        state.map, rgb, depth, jnp.ones(camera.shape, bool), camera, se3.identity(), config.mapping.seeding
    )
    out = render(seeded.gaussians, camera, se3.identity(), config=RenderConfig(pair_capacity=32_768))
    inside = (slice(10, -10), slice(10, -10))
    assert float(jnp.min(out.alpha[inside])) > 0.75
    np.testing.assert_allclose(out.depth[inside], depth[inside], rtol=0.03)
    scales = jnp.exp(seeded.gaussians.log_scales[seeded.gaussians.valid])
    np.testing.assert_allclose(jnp.median(scales[:, 1] / scales[:, 0]), 2**0.5, rtol=0.15)
