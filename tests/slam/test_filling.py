"""Gaussians where no view has measured depth: at a guess, weak, and only once all that was measured is in."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import slam
from sfgs_jax.arrays import InputError
from sfgs_jax.geometry import se3
from sfgs_jax.slam.config import SeedingConfig
from sfgs_jax.slam.mapping import filled, insert_view, refine_once, view_of
from sfgs_jax.splatting import RenderConfig, render


def test_holes_take_the_depth_around_them():
    depth = np.full((30, 37), 2.0, np.float32)
    depth[:, 20:] = 3.0
    holes = np.zeros_like(depth, bool)
    holes[4:9, 3:8] = holes[10:20, 30:] = holes[25:, :4] = True
    out = np.asarray(filled(jnp.asarray(np.where(holes, 0, depth))))
    np.testing.assert_array_equal(out[~holes], depth[~holes])
    np.testing.assert_allclose(out[holes], depth[holes])


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (6, 4), (33, 64)])
def test_one_pixel_fills_an_image_of_any_shape_and_none_leaves_it_empty(shape):
    depth = np.zeros(shape, np.float32)
    np.testing.assert_array_equal(filled(jnp.asarray(depth)), 0)
    depth[-1, -1] = 1.5
    np.testing.assert_array_equal(filled(jnp.asarray(depth)), 1.5)


def map_of(room, frame, config):
    """A map of one view, with nothing but its seeds."""
    bare = replace(config.mapping, steps_per_view=0)
    view = view_of(frame, 1, 0, se3.identity(), 0, np.zeros(6, np.float32))
    poses = np.asarray([[1, 0, 0, 0, 0, 0, 0]], np.float32)
    mapping = replace(slam.init(room.camera, replace(config, mapping=bare)).mapping, keyframe_poses=poses)
    return insert_view(mapping, view, room.camera, bare)[0], bare


def test_the_first_epoch_fills_what_was_not_measured_with_weak_gaussians(room, frames, config):
    frame = frames[0]
    unmeasured = np.zeros(room.camera.shape, bool)
    unmeasured[:, :24] = unmeasured[40:64, 60:90] = True
    valid = np.ones(room.camera.shape, bool)
    valid[:, :8] = False
    depth = np.where(unmeasured, 0, np.asarray(frame.depth))
    mapping, bare = map_of(room, replace(frame, depth=depth, valid=valid), config)

    def alpha(mapping):
        out = render(
            mapping.map.gaussians, room.camera, se3.identity(), config=RenderConfig(pair_capacity=65_536)
        )
        return np.asarray(out.alpha)

    filled_map, _ = refine_once(mapping, room.camera, bare, number=0, done=0.0, seed=0)
    old = np.asarray(mapping.map.gaussians.valid)
    new = np.asarray(filled_map.map.gaussians.valid) & ~old
    assert 10 < new.sum() < unmeasured.sum() / bare.seeding.max_cell**2 * 1.5
    pixels = np.asarray(room.camera.project(filled_map.map.gaussians.means[new]))
    column, row = np.round(pixels).astype(int).T
    cell = bare.seeding.max_cell // 2
    near = np.pad(unmeasured, cell)[row + cell, column + cell]
    assert np.all(near)
    assert np.all(column >= 8)
    opacities = 1 / (1 + np.exp(-np.asarray(filled_map.map.gaussians.opacity_logits)))
    np.testing.assert_allclose(opacities[new], bare.seeding.filled_opacity, rtol=1e-5)
    inner = np.zeros_like(unmeasured)
    inner[:, 12:20] = inner[44:60, 66:84] = True
    assert alpha(mapping)[inner].mean() < 0.2
    assert alpha(filled_map)[inner].mean() > 0.45
    # At a depth near the surface's own, which the hole hides from the map.
    true = np.asarray(frame.depth)[row, column]
    guessed = np.asarray(filled_map.map.gaussians.means)[new, 2]
    assert np.median(np.abs(guessed - true) / true) < 0.1


def test_the_depth_of_a_hole_is_the_maps_where_another_view_has_measured_it(room, frames, config):
    mapping, bare = map_of(room, frames[0], config)
    hole = np.asarray(frames[0].depth).copy()
    hole[30:60, 40:80] = 0
    views = (view_of(replace(frames[0], depth=hole), 1, 0, se3.identity(), 0, np.zeros(6, np.float32)),)
    after, _ = refine_once(replace(mapping, views=views), room.camera, bare, number=0, done=0.0, seed=0)
    assert after.num_gaussians == mapping.num_gaussians


def test_far_surface_is_filled_where_it_was_measured(room, frames, config):
    """Beyond `max_depth` no seed was set."""
    near = replace(config.mapping.seeding, max_depth=1.5)
    mapping, bare = map_of(room, frames[0], replace(config, mapping=replace(config.mapping, seeding=near)))
    after, _ = refine_once(mapping, room.camera, bare, number=0, done=0.0, seed=0)
    new = np.asarray(after.map.gaussians.valid) & ~np.asarray(mapping.map.gaussians.valid)
    z = np.asarray(after.map.gaussians.means)[new, 2]
    column, row = np.round(np.asarray(room.camera.project(after.map.gaussians.means[new]))).astype(int).T
    assert new.sum() > 20
    assert np.median(np.abs(z / np.asarray(frames[0].depth)[row, column] - 1)) < 0.03


def test_later_epochs_fill_nothing_and_no_opacity_switches_it_off(room, frames, config):
    depth = np.asarray(frames[0].depth).copy()
    depth[:, :24] = 0
    mapping, bare = map_of(room, replace(frames[0], depth=depth), config)
    later, _ = refine_once(mapping, room.camera, bare, number=1, done=0.0, seed=0)
    off = replace(bare, seeding=replace(bare.seeding, filled_opacity=0.0))
    without, _ = refine_once(mapping, room.camera, off, number=0, done=0.0, seed=0)
    first, _ = refine_once(mapping, room.camera, bare, number=0, done=0.0, seed=0)
    assert later.num_gaussians == without.num_gaussians == mapping.num_gaussians < first.num_gaussians


def test_an_opacity_of_one_is_refused():
    with pytest.raises(InputError, match="filled_opacity"):
        SeedingConfig(filled_opacity=1.0)


def test_an_extra_view_sets_the_surface_that_only_it_shows(room, frames, config):
    """At its first turn, at its measured depth and as opaque as any seed."""
    half = np.asarray(frames[0].depth).copy()
    half[:, 80:] = 0
    valid = np.ones(room.camera.shape, bool)
    valid[:, 80:] = False
    mapping, bare = map_of(room, replace(frames[0], depth=half, valid=valid), config)
    whole = view_of(frames[0], 1, 0, se3.identity(), 2, np.zeros(6, np.float32), extra=True)
    mapping, _ = insert_view(mapping, whole, room.camera, bare)
    first, _ = refine_once(mapping, room.camera, bare, number=0, done=0.0, seed=0)
    assert first.num_gaussians == mapping.num_gaussians
    second, _ = refine_once(first, room.camera, bare, number=1, done=0.0, seed=0)
    new = np.asarray(second.map.gaussians.valid) & ~np.asarray(mapping.map.gaussians.valid)
    column, row = np.round(np.asarray(room.camera.project(second.map.gaussians.means[new]))).astype(int).T
    assert np.all(column >= 76)
    true = np.asarray(frames[0].depth)[row, np.minimum(column, 159)]
    assert np.median(np.abs(np.asarray(second.map.gaussians.means)[new, 2] / true - 1)) < 0.01
    opacities = 1 / (1 + np.exp(-np.asarray(second.map.gaussians.opacity_logits)[new]))
    np.testing.assert_allclose(opacities, bare.seeding.opacity, rtol=1e-5)
    third, _ = refine_once(second, room.camera, bare, number=2, done=0.0, seed=0)
    assert third.num_gaussians == second.num_gaussians
