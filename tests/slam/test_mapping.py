"""The map: seeds on the surface, optimisation that helps, slots that are used again."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest

from sfgs_jax import Camera, slam
from sfgs_jax.arrays import bucket
from sfgs_jax.evaluation import psnr
from sfgs_jax.geometry import se3
from sfgs_jax.slam.config import LearningRates, MappingConfig
from sfgs_jax.slam.mapping import (
    compile_ahead,
    image_shift,
    insert_view,
    optimise_once,
    prepare_refinement,
    prune,
    refine_once,
    seed,
    step_on_view,
    view_is_due,
    view_of,
)
from sfgs_jax.slam.state import View, corrections_of, empty_log, gains_of, grow, move
from sfgs_jax.splatting import RenderConfig, render

DEFAULT = MappingConfig()
QUALITY_DB = 31.8
"""PSNR of the small map, held-out frames among its scored ones."""


@pytest.fixture
def seeded(room, frames, config):
    """A state whose map was seeded from one frame and not optimised."""
    bare = replace(config, mapping=replace(config.mapping, steps_per_frame=0, steps_per_view=0))
    return slam.step(slam.init(room.camera, bare), frames[0])[0]


def render_psnr(state, frame):
    out = render(state.gaussians, state.camera, state.T_world_cam, config=RenderConfig(pair_capacity=32_768))
    return float(psnr(out.rgb, jnp.asarray(frame.rgb)))


def test_seeds_lie_on_the_surface_and_show_its_colours(seeded, frames):
    gaussians = seeded.gaussians
    means = np.asarray(gaussians.means[gaussians.valid])
    pixels = np.asarray(seeded.camera.project(jnp.asarray(means)))
    depth = frames[0].depth[np.round(pixels[:, 1]).astype(int), np.round(pixels[:, 0]).astype(int)]
    assert np.median(np.abs(means[:, 2] - depth) / depth) < 0.01
    assert render_psnr(seeded, frames[0]) > 17


def test_a_view_the_map_covers_adds_almost_nothing(seeded, frames, config):
    before = seeded.mapping.num_gaussians
    every = replace(
        seeded, config=replace(seeded.config, mapping=replace(seeded.config.mapping, view_interval=1))
    )
    after, info = slam.step(every, frames[0])
    assert info.new_view
    assert after.mapping.num_gaussians - before < 0.1 * before


@pytest.mark.parametrize("steps", [0, 1, 3])
def test_the_first_step_on_a_new_view_is_for_what_the_map_had_before(seeded, frames, steps):
    mapping = replace(seeded.config.mapping, view_interval=1, steps_per_view=steps)
    before = replace(seeded, config=replace(seeded.config, mapping=mapping))
    after, info = slam.step(before, frames[3])
    assert info.new_view
    assert after.mapping.num_steps == before.mapping.num_steps + steps
    old, new = before.gaussians.valid, after.gaussians.valid & ~before.gaussians.valid
    assert jnp.sum(new) > 20
    assert jnp.max(jnp.where(old, after.mapping.map.updates, 0)) == steps
    assert jnp.max(jnp.where(new, after.mapping.map.updates, 0)) == max(steps - 1, 0)
    moved = jnp.any(after.gaussians.means != before.gaussians.means, axis=1)
    assert bool(jnp.any(old & moved)) == (steps > 0)


def test_optimisation_brings_the_rendering_closer(seeded, frames):
    before = render_psnr(seeded, frames[0])
    mapping, losses = seeded.mapping, []
    for _ in range(30):
        mapping, loss = optimise_once(mapping, seeded.mapping_camera, seeded.config.mapping, newest_share=0.3)
        losses.append(loss)
    assert losses[-1] < 0.75 * losses[0]
    assert render_psnr(replace(seeded, mapping=mapping), frames[0]) > before + 1.5


def test_pixels_beyond_the_lens_get_no_gaussian_and_pull_none(room, frames, config):
    """Their colour and depth have no influence on the map, whatever they hold."""
    bare = replace(config, mapping=replace(config.mapping, steps_per_frame=0, steps_per_view=0))
    valid = np.ones(room.camera.shape, bool)
    valid[:, :16] = False
    maps, identity = [], np.asarray([[1, 0, 0, 0, 0, 0, 0]], np.float32)
    for colour in (0, 1):
        rgb = np.where(valid[..., None], frames[0].rgb, np.float32(colour))
        depth = np.where(valid, frames[0].depth, np.float32(1 + colour))
        frame = replace(frames[0], rgb=rgb, depth=depth, valid=valid)
        view = view_of(frame, 1, 0, se3.identity(), 0, np.zeros(6, np.float32))
        mapping = replace(
            slam.init(room.camera, bare).mapping,
            keyframe_poses=identity,
        )
        mapping, _ = insert_view(mapping, view, room.camera, bare.mapping)
        mapping, _ = optimise_once(mapping, room.camera, bare.mapping, newest_share=1.0)
        maps.append(mapping.map.gaussians)
    for a, b in zip(*map(jax.tree.leaves, maps), strict=True):
        np.testing.assert_array_equal(a, b)
    means = np.asarray(maps[0].means[maps[0].valid])
    assert np.asarray(room.camera.project(jnp.asarray(means)))[:, 0].min() > 14


def test_gaussians_out_of_view_keep_their_place_and_their_moments(seeded):
    behind = seeded.gaussians.means.at[0].set(jnp.asarray([0.0, 0.0, -2.0]))
    mapping = eqx.tree_at(lambda m: m.map.gaussians.means, seeded.mapping, behind)
    for _ in range(3):
        mapping, _ = optimise_once(mapping, seeded.mapping_camera, seeded.config.mapping, newest_share=0.3)
    np.testing.assert_array_equal(mapping.map.gaussians.means[0], [0.0, 0.0, -2.0])
    assert mapping.map.updates[0] == 0
    assert jnp.max(mapping.map.updates) == 3


def test_unused_slots_never_matter(seeded):
    used = np.asarray(seeded.gaussians.valid)
    nan = jnp.where(used[:, None], seeded.gaussians.means, jnp.nan)
    dirty = eqx.tree_at(lambda m: m.map.gaussians.means, seeded.mapping, nan)
    settings = seeded.mapping_camera, seeded.config.mapping
    mapping, loss = optimise_once(dirty, *settings, newest_share=0.3)
    clean, clean_loss = optimise_once(seeded.mapping, *settings, newest_share=0.3)
    assert loss == pytest.approx(clean_loss)
    np.testing.assert_allclose(mapping.map.gaussians.means[used], clean.map.gaussians.means[used])


def test_pruned_slots_are_filled_again(seeded, frames, config):
    valid = np.asarray(seeded.gaussians.valid)
    faint = jnp.where(jnp.arange(valid.size) < 300, -10.0, seeded.gaussians.opacity_logits)
    broken = seeded.gaussians.means.at[300].set(jnp.nan)
    changed = eqx.tree_at(
        lambda m: (m.gaussians.opacity_logits, m.gaussians.means), seeded.mapping.map, (faint, broken)
    )
    pruned = prune(changed, 0.02)
    assert int(valid.sum()) - int(jnp.sum(pruned.gaussians.valid)) == 301
    assert not jnp.any(pruned.gaussians.valid[:301])

    view = seeded.mapping.views[0]
    everywhere = jnp.ones(view.depth.shape, bool)
    rgb = view.rgb.astype(jnp.float32) / 255
    refilled, dropped = seed(
        pruned,
        rgb,
        view.depth,
        everywhere,
        seeded.mapping_camera,
        se3.identity(),
        jnp.asarray(7, jnp.int32),
        config.mapping.seeding,
    )
    assert int(dropped) == 0
    assert jnp.all(refilled.gaussians.valid[:301])
    assert jnp.all(jnp.isfinite(refilled.gaussians.means))
    assert jnp.all(refilled.updates[:301] == 0)
    assert jnp.all(refilled.keyframes[:301] == 7)


def test_growing_keeps_every_gaussian(seeded):
    larger = grow(seeded.mapping.map)
    size = seeded.gaussians.valid.shape[0]
    assert larger.gaussians.valid.shape[0] == 2 * size
    np.testing.assert_array_equal(larger.gaussians.means[:size], seeded.gaussians.means)
    assert not jnp.any(larger.gaussians.valid[size:])


def test_seeds_of_a_slanted_plane_cover_it(config):
    """Cells are longer down the slope by the cosine of the slant, and the Gaussians stretch to fill them."""
    camera = Camera(80.0, 80.0, 47.5, 35.5, width=96, height=72)
    u = camera.pixels()[..., 0]
    depth = 2.0 / (1 - 1.0 * (u - camera.cx) / camera.fx)
    rgb = jnp.full((*camera.shape, 3), 0.5)
    state = slam.init(camera, config)
    seeded, _ = seed(
        state.mapping.map,
        rgb,
        depth,
        jnp.ones(camera.shape, bool),
        camera,
        se3.identity(),
        jnp.asarray(0, jnp.int32),
        config.mapping.seeding,
    )
    out = render(seeded.gaussians, camera, se3.identity(), config=RenderConfig(pair_capacity=32_768))
    inside = (slice(10, -10), slice(10, -10))
    assert float(jnp.min(out.alpha[inside])) > 0.75
    np.testing.assert_allclose(out.depth[inside], depth[inside], rtol=0.03)
    used = np.asarray(seeded.gaussians.valid)
    scales, points = (np.asarray(x)[used] for x in (seeded.gaussians.log_scales, seeded.gaussians.means))
    cosine = np.abs(points @ [-(0.5**0.5), 0, 0.5**0.5]) / np.linalg.norm(points, axis=1)
    stretch = np.exp(scales[:, 1] - scales[:, 0])
    np.testing.assert_allclose(np.median(stretch * np.maximum(cosine, 0.25)), 1, rtol=0.03)


def test_cells_are_small_where_there_is_detail(config):
    """A wall, half of it bare and half of it striped: the largest cells and the smallest."""
    camera = Camera(80.0, 80.0, 47.5, 35.5, width=96, height=72)
    stripes = np.zeros((*camera.shape, 3), np.float32)
    stripes[:, 48::2] = 1
    state = slam.init(camera, config)
    seeded, _ = seed(
        state.mapping.map,
        jnp.asarray(stripes),
        jnp.full(camera.shape, 2.0),
        jnp.ones(camera.shape, bool),
        camera,
        se3.identity(),
        jnp.asarray(0, jnp.int32),
        config.mapping.seeding,
    )
    used = np.asarray(seeded.gaussians.valid)
    bare = np.asarray(seeded.gaussians.means)[used][:, 0] < 0
    assert (int(bare.sum()), int((~bare).sum())) == (6 * 9, 24 * 36)
    sizes = np.exp(np.asarray(seeded.gaussians.log_scales)[used][:, 0]) / config.mapping.seeding.scale * 40
    np.testing.assert_allclose(sizes[bare], 8, rtol=1e-4)
    np.testing.assert_allclose(sizes[~bare], 2, rtol=1e-4)


def test_gaussians_move_with_their_keyframe(seeded):
    """Half of the map belongs to another keyframe; each half is where its own keyframe's camera sees it."""
    half = jnp.arange(seeded.gaussians.valid.size) % 2
    owned = eqx.tree_at(lambda m: m.keyframes, seeded.mapping.map, half.astype(jnp.int32))
    old = [se3.identity(), se3.exp(jnp.asarray([0.1, 0.0, 0.2, 0.0, 0.3, 0.0]))]
    moves = [se3.identity(), se3.exp(jnp.asarray([0.3, -0.2, 0.1, 0.2, -0.1, 0.4]))]
    new = [se3.compose(move, T) for move, T in zip(moves, old, strict=True)]
    moved = move(owned, *(np.stack([np.asarray(T.wxyz_xyz) for T in poses]) for poses in (old, new)))
    used = seeded.gaussians.valid
    first, second = (np.asarray(used & (half == i)) for i in (0, 1))
    np.testing.assert_allclose(moved.gaussians.means[first], seeded.gaussians.means[first], atol=1e-6)
    expected = se3.transform(moves[1], seeded.gaussians.means[second])
    np.testing.assert_allclose(moved.gaussians.means[second], expected, atol=1e-5)
    whole = eqx.tree_at(lambda m: m.keyframes, owned, jnp.ones_like(owned.keyframes))
    turned = move(whole, *(np.stack([np.asarray(T.wxyz_xyz) for T in poses]) for poses in (old, new)))
    settings = RenderConfig(pair_capacity=32_768)
    before = render(seeded.gaussians, seeded.camera, se3.identity(), config=settings)
    after = render(turned.gaussians, seeded.camera, moves[1], config=settings)
    # Rounding decides which of two surfaces at one depth is in front: alpha doesn't mind, colour a little.
    np.testing.assert_allclose(after.alpha, before.alpha, atol=2e-3)
    assert float(jnp.mean(jnp.abs(after.rgb - before.rgb))) < 5e-3


def test_the_shift_of_an_image_is_its_corners():
    """A turn by a small angle and a step to the side, at two depths; a turn away sees nothing of it."""
    camera = Camera(100.0, 100.0, 49.5, 39.5, width=100, height=80)
    near, far = (np.full(camera.shape, depth, np.float32) for depth in (1.0, 4.0))
    aside = np.eye(4)
    aside[0, 3] = 0.05
    assert image_shift(aside, near, camera) == pytest.approx(0.05, rel=1e-6)
    assert image_shift(aside, far, camera) == pytest.approx(0.0125, rel=1e-6)
    assert image_shift(aside, np.zeros_like(near), camera) == pytest.approx(0.05, rel=1e-6)
    turn = se3.to_matrices(jaxlie.SE3(se3.exp(jnp.asarray([0, 0, 0, 0, 0.01, 0.0])).wxyz_xyz[None]))[0]
    assert 0.01 < image_shift(turn, far, camera) < 0.014
    assert image_shift(np.diag([-1.0, 1, -1, 1]), near, camera) == np.inf


def test_every_eighth_frame_is_never_a_view():
    due = [n for n in range(1, 40) if view_is_due(n, n - 8, [0], DEFAULT, new_keyframe=False, shift=0.0)]
    assert sorted(set(range(1, 40)) - set(due)) == [4, 12, 20, 28, 36]
    assert not view_is_due(12, 8, [0, 12], DEFAULT, new_keyframe=True, shift=0.0)
    assert view_is_due(13, 8, [0, 12], DEFAULT, new_keyframe=False, shift=0.0)  # in place of the keyframe
    assert not view_is_due(14, 8, [0, 12], DEFAULT, new_keyframe=False, shift=0.0)


def test_a_camera_that_stays_takes_no_more_views(room, frames, config):
    mapping = replace(config.mapping, view_interval=1, views_per_keyframe=3, steps_per_view=0)
    still = [replace(frames[0], timestamp=0.1 * number) for number in range(10)]
    run = slam.run(enumerate(still), room.camera, replace(config, mapping=mapping))
    assert len(run.trajectory) == 10
    assert [view.frame for view in run.state.mapping.views] == [0, 1, 2]


def test_views_of_other_exposures_make_one_map(seeded, frames):
    """One frame, and the same frame with half the exposure: their gains tell them apart, the map does not."""
    config = seeded.config.mapping
    config = replace(config, optimisation=replace(config.optimisation, estimate_exposure=True))
    factor = np.asarray([0.5, 0.6, 0.7], np.float32)
    darker = replace(frames[0], rgb=frames[0].rgb * factor)
    (bright,) = seeded.mapping.views
    dark = view_of(darker, 1, 0, bright.T_keyframe_cam, 1, np.zeros(6, np.float32))
    mapping, _ = insert_view(seeded.mapping, dark, seeded.mapping_camera, config)
    for step in range(20):
        mapping, _ = step_on_view(mapping, step % 2, seeded.mapping_camera, config)
    first, second = (np.asarray(view.gain) for view in mapping.views)
    np.testing.assert_allclose(second / first, factor, rtol=0.12)
    apart = replace(config, optimisation=replace(config.optimisation, estimate_exposure=False))
    _, alike = step_on_view(mapping, 1, seeded.mapping_camera, apart)
    _, told = step_on_view(mapping, 1, seeded.mapping_camera, config)
    assert float(told.loss) < 0.5 * float(alike.loss)


def test_one_fit_changes_a_gain_by_a_share(seeded):
    """The view with half the brightness: a comparison says half, a step goes there by a share."""
    config = seeded.config.mapping
    config = replace(config, optimisation=replace(config.optimisation, estimate_exposure=True))
    (view,) = seeded.mapping.views
    dark = replace(view, rgb=np.asarray(view.rgb) // 2)
    mapping = replace(seeded.mapping, views=(dark,))
    _, compared = step_on_view(mapping, 0, seeded.mapping_camera, config, learn=False)
    stepped, _ = step_on_view(mapping, 0, seeded.mapping_camera, config)
    fit = np.asarray(compared.gain)
    np.testing.assert_allclose(fit / view.gain, 0.5, rtol=0.2)
    np.testing.assert_allclose(stepped.views[0].gain / view.gain, (fit / view.gain) ** 0.1, rtol=0.02)


def test_gains_and_corrections_of_frames_lie_between_those_of_the_views():
    log = empty_log()
    for number in range(5):
        log = log.with_frame(0.1 * number**2, number, 0, se3.identity(), np.eye(6))
    image = np.zeros((1, 1, 3), np.uint8)
    views = tuple(
        View(image, np.zeros((1, 1), np.float32), np.ones((1, 1), bool), np.zeros(6, np.float32), 0,
             se3.identity(), number, np.full(3, gain, np.float32), np.full(6, gain / 1000, np.float32), False)
        for number, gain in ((3, 1.5), (1, 0.5))
    )  # fmt: skip
    # Of times 0, 1, 4, 9 and 16: gains are interpolated as logarithms.
    np.testing.assert_allclose(gains_of(log, views)[:, 0], [0.5, 0.5, 0.5 * 3 ** (3 / 8), 1.5, 1.5])
    np.testing.assert_array_equal(gains_of(log, ()), np.ones((5, 3)))
    # Frame 2 is twice as bright as its neighbours, which no view shows.
    log = replace(log, brightness=np.log([[1.0], [1.0], [2.0], [1.0], [1.0]]) * np.ones(3))
    np.testing.assert_allclose(gains_of(log, views)[[1, 3, 4], 0], [0.5, 1.5, 1.5])
    np.testing.assert_allclose(gains_of(log, views)[2, 0], 2 * 0.5 * 3 ** (3 / 8))
    expected = np.asarray([5e-4, 5e-4, 8.75e-4, 1.5e-3, 1.5e-3])
    np.testing.assert_allclose(corrections_of(log, views), np.tile(expected[:, None], 6), rtol=1e-6)
    np.testing.assert_array_equal(corrections_of(log, ()), np.zeros((5, 6)))


@pytest.fixture(scope="module")
def refined(room, frames, config):
    """A map of twelve frames before and after 48 steps of refinement, with its settings."""
    wide = replace(config.mapping, max_view_shift=0.05, steps_per_view=1)
    state = slam.init(room.camera, replace(config, mapping=wide))
    for frame in frames:
        state, _ = slam.step(state, frame)
    mapping, losses = state.mapping, []
    for number in range(48):
        mapping, loss = refine_once(
            mapping, state.mapping_camera, wide, number=number, done=number / 48, seed=0
        )
        losses.append(loss)
    return state, mapping, losses


def test_the_quality_of_a_small_map(refined, frames):
    """Gate: frame 4 and its neighbours were never views. A change that costs half a decibel fails here."""
    state, mapping, _ = refined
    after = replace(state, mapping=mapping)
    figures = []
    for number in (3, 4, 5):
        pose = se3.from_matrix(after.trajectory.poses[number])
        out = render(after.gaussians, after.camera, pose, config=RenderConfig(pair_capacity=65_536))
        assert int(out.overflow) == 0
        figures.append(float(psnr(out.rgb, jnp.asarray(frames[number].rgb))))
    assert np.mean(figures) > QUALITY_DB - 0.5


def test_refinement_turns_views_and_their_neighbours_to_where_the_images_fit(refined, rng):
    """The map stays as it is; its views are turned by a third of a degree at first, about half a pixel."""
    state, mapping, _ = refined
    turns = rng.normal(0, 0.006 / np.sqrt(3), (len(mapping.views), 6)) * [0, 0, 0, 1, 1, 1]
    views = tuple(
        replace(view, correction=np.asarray(turn, np.float32))
        for view, turn in zip(mapping.views, turns, strict=True)
    )
    spoiled = mapping = replace(mapping, views=views)
    rates = LearningRates(0.0, 0.0, 0.0, 0.0, 0.0, poses=2e-3)
    config = state.config.mapping
    config = replace(config, optimisation=replace(config.optimisation, learning_rates=rates))
    for number in range(40):
        done = number / 40
        mapping, _ = refine_once(mapping, state.mapping_camera, config, number=number, done=done, seed=0)

    def off(mapping):
        """Angles by which the frames, views or not, are turned from where they were tracked, radians."""
        poses = replace(state, mapping=mapping).trajectory.poses
        return np.linalg.norm(se3.logs_of(np.linalg.inv(state.trajectory.poses) @ poses)[:, 3:], axis=1)

    assert off(spoiled).mean() > 0.004
    assert off(mapping).mean() < off(spoiled).mean() / 3


def test_refinement_sees_every_view_once_an_epoch_and_comes_to_rest(refined):
    state, mapping, losses = refined
    views = len(state.mapping.views)
    assert mapping.num_steps == state.mapping.num_steps + 48
    assert np.mean(losses[-views:]) < 0.7 * np.mean(losses[:views])
    config = state.config.mapping
    first, last = (
        refine_once(mapping, state.mapping_camera, config, number=48, done=done, seed=0)[0]
        for done in (0.0, 1.0)
    )
    moved = [jnp.abs(after.map.gaussians.sh - mapping.map.gaussians.sh).max() for after in (first, last)]
    assert float(moved[1]) == pytest.approx(config.final_rate * float(moved[0]), rel=0.05)


def test_extra_views_take_the_place_of_the_view_before_them_in_turns(refined):
    state, _, _ = refined
    kinds = [False, True, True, False, False, True]
    views = tuple(replace(state.mapping.views[0], frame=i, extra=extra) for i, extra in enumerate(kinds))
    seen = []
    for number in range(3 * 6):
        before = replace(state.mapping, views=views)
        after, _ = refine_once(
            before, state.mapping_camera, state.config.mapping, number=number, done=0.5, seed=1
        )
        turned = [
            not np.array_equal(a.correction, b.correction) for a, b in zip(views, after.views, strict=True)
        ]
        seen.append(turned.index(True))
    epochs = [sorted(seen[i : i + 3]) for i in range(0, len(seen), 3)]
    assert epochs == [[0, 3, 4], [1, 3, 5], [2, 3, 4], [0, 3, 5], [1, 3, 4], [2, 3, 5]]


def test_the_larger_map_is_compiled_before_it_is_needed(seeded, config, compilations):
    mapping, camera = seeded.mapping, seeded.mapping_camera
    settings = replace(config.mapping, steps_per_frame=1)
    assert not compile_ahead(mapping, camera, settings, needed=0, in_view=0), "it is not three quarters full"
    used = mapping.num_gaussians
    full = jax.tree.map(lambda x: x[: int(used / 0.9)], mapping.map)
    assert int(full.gaussians.valid.sum()) == used, "the used slots come first"
    mapping = replace(mapping, map=full)
    (prepared,) = compile_ahead(mapping, camera, settings, needed=0, in_view=0)
    prepared.result()

    compilations.clear()
    mapping = replace(mapping, map=grow(mapping.map))
    mapping, _ = insert_view(mapping, mapping.views[0], camera, settings)
    mapping, _ = optimise_once(mapping, camera, settings, newest_share=1.0)
    moved = mapping.keyframe_poses + np.float32(1e-3)
    pruned = prune(mapping.map, settings.prune_opacity)
    jax.block_until_ready((pruned, move(mapping.map, mapping.keyframe_poses, moved)))
    assert not compilations
    mapping = replace(mapping, map=full)
    assert not compile_ahead(mapping, camera, settings, needed=0, in_view=0), "it was asked for"


def test_room_for_more_keyframes_is_compiled_before_it_is_needed(seeded, config, compilations):
    poses = np.repeat(seeded.mapping.keyframe_poses[:1], 130, axis=0)
    mapping, camera = replace(seeded.mapping, keyframe_poses=poses[:90]), seeded.mapping_camera
    assert not compile_ahead(mapping, camera, config.mapping, needed=0, in_view=0), "there is room for 128"
    mapping = replace(mapping, keyframe_poses=poses[:100])
    (prepared,) = compile_ahead(mapping, camera, config.mapping, needed=0, in_view=0)
    prepared.result()
    compilations.clear()
    jax.block_until_ready(move(mapping.map, poses, poses))
    assert not compilations


def test_more_room_for_pairs_is_compiled_before_it_is_needed(seeded, config, compilations):
    mapping, camera = seeded.mapping, seeded.mapping_camera
    settings = replace(config.mapping, steps_per_frame=1)
    _, done = step_on_view(mapping, 0, camera, settings, learn=False)
    needed = int(done.needed)
    tight = replace(mapping, pair_capacity=needed * 5 // 4)
    assert int(step_on_view(tight, 0, camera, settings, learn=False)[1].overflow) == 0
    (prepared,) = compile_ahead(tight, camera, settings, needed=needed, in_view=0)
    prepared.result()

    compilations.clear()
    roomy = replace(tight, pair_capacity=2 * tight.pair_capacity)
    roomy, _ = insert_view(roomy, roomy.views[0], camera, settings)
    optimise_once(roomy, camera, settings, newest_share=1.0)
    assert not compilations
    assert not compile_ahead(tight, camera, settings, needed=needed, in_view=0), "it was asked for"


def test_more_room_for_gaussians_in_view_is_compiled_before_it_is_needed(seeded, config, compilations):
    mapping, camera = seeded.mapping, seeded.mapping_camera
    _, done = step_on_view(mapping, 0, camera, config.mapping, learn=False)
    seen = int(done.in_view)
    tight = replace(mapping, view_capacity=seen * 5 // 4)
    (prepared,) = compile_ahead(tight, camera, config.mapping, needed=0, in_view=seen)
    prepared.result()

    compilations.clear()
    roomy = replace(tight, view_capacity=bucket(tight.view_capacity + 1, steps=2))
    insert_view(roomy, roomy.views[0], camera, config.mapping)
    assert not compilations


def test_a_view_that_lacks_room_for_pairs_gets_it(seeded, config):
    mapping, camera = seeded.mapping, seeded.mapping_camera
    _, roomy = step_on_view(mapping, 0, camera, config.mapping)
    needed = int(roomy.needed)
    assert 0 < needed < mapping.pair_capacity
    after, tight = step_on_view(replace(mapping, pair_capacity=needed - 1), 0, camera, config.mapping)
    assert after.pair_capacity == 2 * (needed - 1)
    assert int(tight.overflow) == 0
    np.testing.assert_allclose(tight.loss, roomy.loss, rtol=1e-6)


@pytest.mark.parametrize("learn", [True, False])
def test_a_view_that_lacks_room_for_gaussians_gets_it(seeded, config, learn: bool):
    mapping, camera = seeded.mapping, seeded.mapping_camera
    before, roomy = step_on_view(mapping, 0, camera, config.mapping, learn=learn)
    seen = int(roomy.in_view)
    assert seen > 1
    cramped = replace(mapping, view_capacity=seen // 2)
    after, tight = step_on_view(cramped, 0, camera, config.mapping, learn=learn)
    assert seen <= after.view_capacity < 2 * seen
    assert int(tight.in_view) == seen
    assert int(tight.overflow) == 0
    np.testing.assert_allclose(tight.loss, roomy.loss, rtol=1e-6)
    for one, other in zip(jax.tree.leaves(before.map), jax.tree.leaves(after.map), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("lacking", ["pair_capacity", "view_capacity"])
def test_a_step_on_an_incomplete_rendering_leaves_the_map(seeded, lacking: str):
    mapping, view = seeded.mapping, seeded.mapping.views[0]
    room = {"pair_capacity": mapping.pair_capacity, "view_capacity": mapping.view_capacity, lacking: 64}
    params = slam.MapParams(
        camera=seeded.mapping_camera,
        timing=None,
        mean_gain=None,
        rate=jnp.ones(()),
        config=seeded.config.mapping.optimisation,
        seeding=seeded.config.mapping.seeding,
        **room,
    )
    done = slam.map_step(params, mapping.map, view, seeded.T_world_cam)
    assert int(done.overflow) > 0
    for one, other in zip(jax.tree.leaves(mapping.map), jax.tree.leaves(done.map), strict=True):
        np.testing.assert_array_equal(one, other)


def test_what_is_out_of_view_stays_as_it_was(seeded, config):
    mapping, camera = seeded.mapping, seeded.mapping_camera
    away = replace(mapping.views[0], T_keyframe_cam=se3.exp(jnp.asarray([0.0, 0, 0, 0, 0.4, 0])))
    mapping = replace(mapping, views=(away,))
    after, done = step_on_view(mapping, 0, camera, config.mapping)
    moved = np.any(np.asarray(after.map.gaussians.means != mapping.map.gaussians.means), axis=1)
    assert 0 < moved.sum() <= int(done.in_view) < mapping.num_gaussians
    still = ~moved
    for one, other in zip(jax.tree.leaves(mapping.map), jax.tree.leaves(after.map), strict=True):
        np.testing.assert_array_equal(np.asarray(one)[still], np.asarray(other)[still])


def test_the_refinement_has_its_room_before_its_time_begins(seeded, config, compilations):
    cramped, camera = replace(seeded.mapping, view_capacity=64), seeded.mapping_camera
    prepared = prepare_refinement(cramped, camera, config.mapping, seed=0)
    assert prepared.view_capacity > 64
    assert prepared.map is cramped.map, "the steps are forgotten"
    assert prepared.num_steps == cramped.num_steps

    compilations.clear()
    refined, _ = refine_once(prepared, camera, config.mapping, number=0, done=0.0, seed=0)
    assert not compilations
    assert refined.view_capacity == prepared.view_capacity


def test_the_refinement_has_room_for_a_view_that_is_not_tried(seeded, config):
    """Nineteen views look away; the one that does not comes late in the order of the refinement."""
    mapping, camera, (view,) = seeded.mapping, seeded.mapping_camera, seeded.mapping.views
    away = replace(view, T_keyframe_cam=se3.exp(jnp.asarray([0.0, 0, 0, 0, jnp.pi, 0])))
    late = int(np.random.default_rng([0, 0]).permutation(20)[-1])
    views = tuple(view if number == late else away for number in range(20))
    prepared = prepare_refinement(
        replace(mapping, views=views, view_capacity=8), camera, config.mapping, seed=0
    )
    _, seen = step_on_view(mapping, 0, camera, config.mapping)
    assert prepared.view_capacity >= int(seen.in_view) > 64
