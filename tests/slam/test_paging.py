"""Paging: Gaussians of far places leave the map, and are the same when they come back."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from sfgs_jax import slam
from sfgs_jax.geometry import se3
from sfgs_jax.slam.config import MappingConfig, PagingConfig
from sfgs_jax.slam.mapping import follow_keyframes, insert_view, optimise_once, refine_once, view_of
from sfgs_jax.slam.run import remove_other_images, spill_views
from sfgs_jax.splatting import GAUSSIAN_PARAMETERS

FAR = 16
"""Keyframe of the second place, 50 m from the first, the next group of keyframes."""


@pytest.fixture(scope="module")
def poses():
    rows = np.zeros((FAR + 1, 7), np.float32)
    rows[:, 0] = 1
    rows[FAR, 4] = 50
    return rows


@pytest.fixture(scope="module")
def places(room, frames, config, poses):
    """The state, and views of two places that look alike, one of them far from the other."""
    small = replace(config.mapping, paging=PagingConfig(memory_mb=0.5), final_steps=2)
    state = slam.init(room.camera, replace(config, mapping=small))
    still = np.zeros(6, np.float32)
    views = [view_of(frames[0], 1, k, se3.identity(), n, still) for n, k in enumerate((0, FAR))]
    mapping = replace(state.mapping, keyframe_poses=poses)
    return replace(state, mapping=mapping), *views


@pytest.fixture(scope="module")
def paged(places):
    """The map of the first place, and the same after the second made it leave."""
    state, near, far = places
    config = state.config.mapping
    first, _ = insert_view(state.mapping, near, room_camera(state), config)
    assert config.gaussians_in_memory * 7 / 8 < 2 * first.num_gaussians
    config = replace(config, paging=PagingConfig(memory_mb=1.1 * first.num_gaussians * 177 / 2**20))
    second, _ = insert_view(first, far, room_camera(state), config)
    return config, first, second


def room_camera(state):
    return state.mapping_camera


def rows(gaussian_map):
    """The Gaussians of the first place and their moments, in the order of their slots, as one matrix."""
    host = jax.tree.map(np.asarray, gaussian_map)
    used = host.gaussians.valid & (host.keyframes == 0)
    values = [getattr(host.gaussians, name)[used] for name in GAUSSIAN_PARAMETERS]
    values += [host.first_moment[name][used] for name in GAUSSIAN_PARAMETERS]
    return np.concatenate([value.reshape(used.sum(), -1) for value in values], axis=1)


def test_a_far_place_leaves_a_full_map_and_is_not_lost(paged):
    _, first, second = paged
    assert not first.submaps
    assert len(second.submaps) == second.num_submaps == 1
    assert len(second.submaps[0]) == first.num_gaussians
    assert set(np.asarray(second.map.keyframes)[np.asarray(second.map.gaussians.valid)]) == {FAR}
    assert second.map.updates.shape == first.map.updates.shape
    assert second.num_gaussians == int(np.asarray(second.whole.gaussians.valid).sum())
    np.testing.assert_allclose(rows(second.whole), rows(first.map), atol=1e-5)


def test_a_place_comes_back_with_a_view_of_it_and_nothing_is_set_twice(places, paged):
    state, near, _ = places
    config, first, second = paged
    again, _ = insert_view(second, near, room_camera(state), config)
    assert {submap.keyframe for submap in again.submaps} == {FAR}
    here = np.asarray(again.map.gaussians.valid) & (np.asarray(again.map.keyframes) == 0)
    assert first.num_gaussians <= here.sum() < 1.1 * first.num_gaussians


def test_a_place_that_was_moved_while_it_was_away_comes_back_there(places, paged, poses):
    state, near, _ = places
    config, first, second = paged
    moved = poses.copy()
    moved[0] = [np.cos(0.1), 0, np.sin(0.1), 0, 1, 2, 3]
    after = follow_keyframes(second, moved, None)
    there = follow_keyframes(first, moved, None)
    np.testing.assert_allclose(rows(after.whole), rows(there.map), atol=1e-4)
    again, _ = insert_view(after, near, room_camera(state), config)
    assert {submap.keyframe for submap in again.submaps} == {FAR}


def test_the_memory_holds_the_slots_of_a_map_that_has_doubled_a_few_times():
    config = MappingConfig(capacity=1000, max_capacity=8000)
    assert PagingConfig(memory_mb=1.0).most_gaussians == 2**20 // 177
    for memory_mb, most in ((0.1, 592), (0.2, 1000), (0.5, 2000), (1.0, 4000)):
        sized = replace(config, paging=PagingConfig(memory_mb=memory_mb))
        assert sized.gaussians_in_memory == most


def test_a_map_with_room_keeps_all(places, paged):
    state, _, far = places
    _, first, _ = paged
    both, _ = insert_view(
        first, far, room_camera(state), replace(state.config.mapping, paging=PagingConfig())
    )
    assert not both.submaps
    assert both.whole is both.map


def test_only_views_of_surface_in_the_map_are_optimised(places, paged):
    state, _, _ = places
    config, _, second = paged
    before = second.views[0].gain
    for _ in range(4):
        second, _ = optimise_once(second, room_camera(state), config, newest_share=0.0)
    assert second.views[0].gain is before
    assert second.num_submaps == 1


def test_the_refinement_goes_from_place_to_place(places, paged):
    state, _, _ = places
    config, _, second = paged
    seen = []
    for number in range(4):
        second, loss = refine_once(second, room_camera(state), config, number=number, done=0.5, seed=0)
        seen.append(second.submaps[0].keyframe)
        assert np.isfinite(loss)
    assert seen == [FAR, 0, FAR, 0]


def test_submaps_are_saved_and_spilled(places, paged, tmp_path):
    state, _, _ = places
    _, _, second = paged
    state = replace(state, mapping=second)
    slam.save(state, tmp_path)
    again = slam.load(tmp_path, state.config)
    spilled = replace(state, mapping=spill_views(second, tmp_path / "images", 128))
    for other in (again, spilled):
        assert isinstance(other.mapping.submaps[0].content.updates, np.memmap)
        for a, b in zip(jax.tree.leaves(other.mapping), jax.tree.leaves(second), strict=True):
            np.testing.assert_array_equal(a, b)
    assert len(list(tmp_path.glob("submap-*"))) == 1
    returned = replace(state, mapping=replace(second, submaps=()))
    remove_other_images(returned, tmp_path / "images")
    assert not list((tmp_path / "images").glob("submap-*"))
    slam.save(returned, tmp_path)
    assert not list(tmp_path.glob("submap-*"))


def test_a_run_that_pages_goes_on_from_a_checkpoint_to_the_same_end(room, frames, config, tmp_path):
    paging = PagingConfig(memory_mb=0.2, reach=0.0, place_keyframes=1)
    mapping = replace(config.mapping, view_interval=2, views_in_memory=1, paging=paging, steps_per_frame=1)
    config, offered = replace(config, mapping=mapping), list(enumerate(frames))

    def keep(progress):
        if progress.stage == "frames" and progress.done == 7:
            slam.save_run(progress.run, tmp_path)

    whole = slam.run(offered, room.camera, config, storage=tmp_path, observer=keep)
    assert whole.state.mapping.num_submaps > 4
    half = slam.load_run(tmp_path, config)
    assert half.num_frames == 7
    again = slam.run(offered[7:], room.camera, config, storage=tmp_path, resumed=half)
    for a, b in zip(jax.tree.leaves(again.state), jax.tree.leaves(whole.state), strict=True):
        np.testing.assert_array_equal(a, b)
