"""One step of the system: poses, keyframes, lost frames, compilations."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import Frame, slam
from sfgs_jax.arrays import FrameError, InputError
from sfgs_jax.evaluation import nees
from sfgs_jax.geometry import se3
from sfgs_jax.slam.keyframes import accept_consistent_loops, likely_drift


def follow(room, frames, config):
    state = slam.init(room.camera, config)
    infos = []
    for frame in frames:
        state, info = slam.step(state, frame)
        infos.append(info)
    return state, infos


def test_tracks_the_room_from_the_first_camera(room, frames, config):
    state, infos = follow(room, frames, config)
    assert all(info.tracked for info in infos)
    np.testing.assert_allclose(se3.matrix(infos[0].T_world_cam), np.eye(4))
    truth = np.linalg.inv(room.ground_truth.poses[0]) @ room.ground_truth.poses
    for info, expected in zip(infos, truth, strict=True):
        np.testing.assert_allclose(se3.matrix(info.T_world_cam)[:3, 3], expected[:3, 3], atol=0.03)
    assert infos[0].new_keyframe
    assert state.next_frame == len(frames)
    assert [keyframe.frame for keyframe in state.graph.keyframes] == [
        i for i, info in enumerate(infos) if info.new_keyframe
    ]
    assert [view.frame for view in state.mapping.views if not view.extra] == [
        i for i, info in enumerate(infos) if info.new_view
    ]
    np.testing.assert_allclose(state.trajectory.poses[:, :3, 3], truth[:, :3, 3], atol=0.03)
    covered = nees(state.trajectory, state.covariances, room.ground_truth)
    assert covered.share_within(3.0) == 1
    assert 0.1 < covered.mean < 12, "neither too sure nor without any claim"
    np.testing.assert_array_equal(infos[0].covariance, 0)
    for info in infos[1:]:
        assert np.linalg.eigvalsh(info.covariance)[0] > 0
        assert np.sqrt(np.trace(info.covariance[:3, :3])) < 0.05


def test_a_frame_between_two_keyframes_may_have_drifted_anywhere_on_their_way(room, frames, config):
    """Known at both ends, a random walk has the variance s (1 - s) of its whole at a share s of the way."""
    state, _ = follow(room, frames, config)
    graph, (first, second) = state.graph, state.graph.keyframes[:2]
    tracked = se3.matrices_of(np.stack([graph.poses[0], second.T_reference_keyframe]))

    def covariances(drift):
        end = tracked[0] @ tracked[1] @ se3.exps_of(np.asarray([drift]))
        poses = graph.poses.copy()
        poses[1] = se3.parameters_of(end)[0]
        return replace(state, graph=replace(graph, poses=poses)).covariances

    more = covariances([0.02, 0, -0.01, 0, 0.03, 0]) - covariances([0.0] * 6)
    # Frames of the first keyframe, as a share of the way to the second; those after it are not on that way.
    share = (state.log.numbers - first.frame) / (second.frame - first.frame)
    share = np.where((state.log.keyframes == 0) & (share < 1), share, 0)
    assert np.count_nonzero(share) > 0
    position, angle = (0.02**2 + 0.01**2) / 3, 0.03**2 / 3
    expected = (share * (1 - share))[:, None] * np.repeat([position, angle], 3)
    np.testing.assert_allclose(more[share > 0], [np.diag(x) for x in expected[share > 0]], atol=2e-6)


def test_a_state_prints_in_a_line_what_a_reader_wants_to_know(room, frames, config):
    state, info = slam.step(slam.init(room.camera, config), frames[0])
    count = f"{state.mapping.num_gaussians} of {config.mapping.capacity}"
    graph = "KeyframeGraph(keyframes=1, edges=0, loops=0, landmarks=0)"
    sh = f"f32[{config.mapping.capacity},1,3]"
    mapping = f"MapState(gaussians=Gaussians(valid={count}, sh={sh}), views=1, num_steps=0)"
    text = f"SlamState(camera={room.camera}, tracked=1, lost=0, graph={graph}, mapping={mapping})"
    assert repr(state) == text
    assert repr(slam.Run(state)) == f"Run(num_frames=0, is_finished=False, state={text})"
    assert repr(state.tracker) == "Tracker(num_keyframes=1, T_world_cam=(0, 0, 0) m 0°, lost_in_a_row=0)"
    assert repr(state.graph.keyframes) == "(Keyframe(frame=0, reference=0),)"
    # Neither traced nor mapped states have numbers.
    traced = []
    jax.jit(lambda tracker: traced.append(repr(tracker)))(state.tracker)
    assert traced == ["Tracker(num_keyframes=i32[], T_world_cam=f32[7], lost_in_a_row=i32[])"]
    assert "lost=None" in repr(jax.tree.map(lambda _: None, state))
    assert "tracked=True" in repr(info)


def test_a_step_leaves_the_state_it_was_given(room, frames, config):
    state, _ = slam.step(slam.init(room.camera, config), frames[0])
    before = [np.asarray(leaf).copy() for leaf in jax.tree.leaves(state)]
    slam.step(state, frames[1])
    for old, leaf in zip(before, jax.tree.leaves(state), strict=True):
        np.testing.assert_array_equal(old, leaf)


def test_steps_are_deterministic(room, frames, config):
    first, _ = follow(room, frames[:4], config)
    second, _ = follow(room, frames[:4], config)
    for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True):
        np.testing.assert_array_equal(a, b)


def test_nothing_compiles_after_the_warm_up(room, frames, config, compilations, rng):
    """Keyframes, views, the window, loops' candidates, pruning and lost frames among what comes later."""
    often = replace(
        config,
        mapping=replace(config.mapping, view_interval=2, prune_interval=4),
        graph=replace(config.graph, loop_gap=1, loop_similarity=0.0),
    )
    jax.jit(lambda x: 3 * x + 1)(jnp.ones(3))
    assert compilations, "the counter must see a program that is new"
    slam.warm_up(room.camera, often)
    state = slam.init(room.camera, often)
    compilations.clear()
    for frame in frames:
        state, _ = slam.step(state, frame)
    assert not compilations
    assert len(state.graph.keyframes) > 2
    assert len(state.graph.edges) > len(state.graph.keyframes) - 1
    assert len(state.graph.landmarks) > 20
    candidates = replace(state.graph, candidates=state.graph.edges[:2])
    _, closed = accept_consistent_loops(candidates, often.graph)
    assert closed
    likely_drift(state.graph, 0, 2, often.graph)
    assert not compilations
    # Nor does a frame that is found nowhere, with keypoints or without.
    nothing = np.zeros(frames[0].depth.shape, np.float32)
    patches = np.kron(rng.random((30, 40, 1)), np.ones((4, 4, 3))).astype(np.float32)
    for rgb in (np.zeros_like(patches), patches):
        _, info = slam.step(state, Frame(rgb, nothing, 1.0))
        assert not info.tracked
    # Nor a frame that comes back after one that was lost.
    lost, _ = slam.step(state, Frame(np.zeros_like(patches), nothing, 1.0))
    _, info = slam.step(lost, replace(frames[0], timestamp=2.0))
    assert not compilations


def test_views_come_at_least_at_the_interval(room, frames, config):
    regular = replace(config, mapping=replace(config.mapping, view_interval=3))
    state, _ = follow(room, frames, regular)
    indices = [view.frame for view in state.mapping.views if not view.extra]
    assert max(np.diff([*indices, len(frames)])) <= 3


@pytest.fixture(scope="module")
def hasty_run(room, frames, config):
    """The run after five frames so far apart that each became a keyframe; the last is held out.

    The camera comes back to where it was, but does not return to its keyframes there.
    """
    forgetful = replace(config, graph=replace(config.graph, return_to_keyframes=False))
    return follow(room, [frames[i] for i in (0, 3, 5, 8, 10)], forgetful)[0]


def test_keyframes_are_views_however_fast_they_come(hasty_run):
    assert len(hasty_run.graph.keyframes) == 5
    assert [view.frame for view in hasty_run.mapping.views] == [0, 1, 2, 3]


@pytest.fixture(scope="module")
def there(room, frames, config):
    """The run after nine frames."""
    return follow(room, frames[:9], config)[0]


def test_on_the_way_back_the_camera_returns_to_its_keyframes(there, room, frames):
    state, truth = there, np.linalg.inv(room.ground_truth.poses[0]) @ room.ground_truth.poses
    count = len(state.graph.keyframes)
    assert count > 3
    references = []
    for i in range(7, -1, -1):
        again = replace(frames[i], timestamp=frames[8].timestamp + (8 - i) / 30)
        state, info = slam.step(state, again)
        assert info.tracked
        assert not info.new_keyframe
        np.testing.assert_allclose(se3.matrix(info.T_world_cam)[:3, 3], truth[i, :3, 3], atol=0.03)
        assert np.isfinite(info.covariance).all()
        references.append(int(state.log.keyframes[-1]))
    assert len(state.graph.keyframes) == count
    assert references == sorted(references, reverse=True)
    assert references[-1] == 0


def test_where_the_graph_contradicts_a_keyframe_the_camera_takes_a_new_one(there, frames):
    """The first keyframes lie 4 cm off, many times the noise: edges have to mend that."""
    poses = there.graph.poses.copy()
    poses[:-2, 4] += 0.04
    state = replace(there, graph=replace(there.graph, poses=poses, adjustment=None))
    taken = []
    for i in range(7, -1, -1):
        again = replace(frames[i], timestamp=frames[8].timestamp + (8 - i) / 30)
        state, info = slam.step(state, again)
        taken.append(info.new_keyframe)
    assert any(taken)


def test_adjust_finds_the_same_window_from_another_start(hasty_run, config, rng):
    """Poses and landmarks come back from 5 mm and 5 mrad away, the first pose stays, the cost falls."""
    state = slam.finish(hasty_run)
    window = slam.window_of(state.params, state.graph, config.graph)
    expected = slam.adjust(state.params, window)
    tangents = 0.005 * rng.normal(size=(len(window.values.poses.wxyz_xyz), 6))
    tangents[~window.graph.free_poses] = 0
    shaken = se3.compose(window.values.poses, se3.exp(jnp.asarray(tangents, jnp.float32)))
    window = eqx.tree_at(lambda w: w.values.poses, window, shaken)
    found = slam.adjust(state.params, window)
    for _ in range(3):
        window = eqx.tree_at(lambda w: w.values, window, found.solution.values)
        found = slam.adjust(state.params, window)
    found, expected = found.solution, expected.solution
    assert float(found.cost) < 1.01 * float(expected.cost) + 1e-3
    poses = found.values.poses.wxyz_xyz
    np.testing.assert_allclose(poses, expected.values.poses.wxyz_xyz, atol=5e-4)
    np.testing.assert_array_equal(poses[0], window.values.poses.wxyz_xyz[0])


def test_an_image_that_has_moved_on_is_a_view(room, frames, config):
    """Frames turn by some degrees each: with a small shift asked for, every frame but each eighth is one."""
    state, _ = follow(room, frames[:6], replace(config, mapping=replace(config.mapping, max_view_shift=0.01)))
    assert [view.frame for view in state.mapping.views] == [0, 1, 2, 3, 5]


def test_a_keyframe_is_no_view_where_one_was_just_taken(room, frames, config):
    """The camera rests, which makes no keyframes, and then is elsewhere."""
    mapping = replace(config.mapping, view_interval=5, max_view_shift=10.0, extra_interval=0)
    regular = replace(config, mapping=mapping)
    for number, views in ((6, [0, 5]), (8, [0, 5, 8])):
        state, infos = follow(room, [frames[0]] * number, regular)
        assert [info.new_keyframe for info in infos] == [True] + [False] * (number - 1)
        assert [view.frame for view in state.mapping.views] == [0, 5]
        state, info = slam.step(state, frames[3])
        assert info.new_keyframe
        assert [view.frame for view in state.mapping.views] == views


def test_frames_between_views_are_kept_for_the_refinement_alone(room, frames, config):
    """Every second one, but not each eighth, and none beyond the number asked for."""
    mapping = replace(config.mapping, view_interval=20, max_view_shift=10.0, extra_interval=2)
    still = [replace(frames[0], timestamp=0.1 * number) for number in range(10)]
    state, infos = follow(room, still, replace(config, mapping=mapping))
    assert [(view.frame, view.extra) for view in state.mapping.views] == [
        (0, False), (2, True), (6, True), (8, True),
    ]  # fmt: skip
    assert [info.new_view for info in infos] == [True] + [False] * 9
    alone, _ = follow(room, still[:1], replace(config, mapping=mapping))
    assert state.mapping.num_steps == alone.mapping.num_steps
    for one, other in zip(*map(jax.tree.leaves, (state.mapping.map, alone.mapping.map)), strict=True):
        np.testing.assert_array_equal(one, other)
    full = replace(mapping, extra_until=3, extra_interval=1)
    state, _ = follow(room, still, replace(config, mapping=full))
    assert [view.frame for view in state.mapping.views] == [0, 1, 2]
    short = replace(mapping, view_interval=5, extra_interval=1, views_per_keyframe=1)
    state, _ = follow(room, still, replace(config, mapping=short))
    assert [view.frame for view in state.mapping.views] == [0, 1, 2, 3], "the camera stays"


def test_a_frame_of_something_else_is_lost_and_the_next_is_found_again(room, frames, config, rng):
    state, _ = follow(room, frames[:3], config)
    noise = rng.uniform(0.5, 5.0, frames[0].depth.shape).astype(np.float32)
    colours = rng.random(frames[0].rgb.shape, np.float32)
    lost_state, info = slam.step(state, Frame(colours, noise, frames[3].timestamp))
    assert not info.tracked
    assert info.source == slam.PoseSource.LOST
    assert np.isinf(np.diag(info.covariance)).all()
    assert not info.new_keyframe
    assert lost_state.num_lost == 1
    assert len(lost_state.trajectory) == 3
    np.testing.assert_array_equal(info.T_world_cam.wxyz_xyz, state.T_world_cam.wxyz_xyz)
    np.testing.assert_array_equal(lost_state.gaussians.means, state.gaussians.means)
    _, info = slam.step(lost_state, frames[4])
    assert info.tracked
    truth = np.linalg.inv(room.ground_truth.poses[0]) @ room.ground_truth.poses[4]
    np.testing.assert_allclose(se3.matrix(info.T_world_cam)[:3, 3], truth[:3, 3], atol=0.03)


def test_missing_depth_in_any_disguise_is_missing(room, frames, config):
    depth = frames[1].depth.copy()
    zeros, disguised = depth.copy(), depth.copy()
    zeros[10:20, 10:40] = 0
    disguised[10:15, 10:40] = np.nan
    disguised[15:20, 10:25] = np.inf
    disguised[15:20, 25:40] = -1
    state, _ = slam.step(slam.init(room.camera, config), frames[0])
    a, _ = slam.step(state, Frame(frames[1].rgb, zeros, 0.0))
    b, _ = slam.step(state, Frame(frames[1].rgb, disguised, 0.0))
    np.testing.assert_array_equal(a.T_world_cam.wxyz_xyz, b.T_world_cam.wxyz_xyz)


def test_no_value_of_a_frame_spoils_poses_or_map(room, frames, config):
    rgb, depth = np.asarray(frames[0].rgb), np.asarray(frames[0].depth)
    images = [(rgb * factor, depth) for factor in (np.nan, np.inf, -1, 1e30, 255)]
    images += [(rgb, depth * np.float32(factor)) for factor in (1e-30, 1e30)]
    images += [(rgb, np.full_like(depth, value)) for value in (3.4e38, 1e-40)]
    for pair in images:
        with pytest.warns(UserWarning, match=r"colours are (not finite|between)|median depth is"):
            state, _ = slam.step(slam.init(room.camera, config), Frame(*pair, frames[0].timestamp))
        state, _ = slam.step(state, frames[1])
        state, _ = slam.step(state, Frame(*pair, frames[2].timestamp))
        state, info = slam.step(state, frames[3])
        for leaf in jax.tree.leaves((info.T_world_cam, state.last_look, state.gaussians)):
            assert np.isfinite(np.asarray(leaf)).all()


def test_a_frame_of_another_size_is_refused(room, frames, config):
    state = slam.init(room.camera, config)
    with pytest.raises(InputError, match="one size"):
        slam.step(state, Frame(frames[0].rgb[:50], frames[0].depth[:50], 0.0))


def test_time_does_not_go_back(room, frames, config):
    state, _ = follow(room, frames[:3], config)
    with pytest.raises(FrameError, match=r"time stamp 0\.0\d+ s is before .* in the order of"):
        slam.step(state, frames[1])
    with pytest.raises(FrameError, match=r"more than an hour after .* in seconds"):
        slam.step(state, replace(frames[3], timestamp=1e9))
    # A run goes on without the frame.
    run = slam.run(enumerate([*frames[:3], frames[1], *frames[3:5]]), room.camera, config)
    assert (run.num_frames, run.num_skipped) == (6, 1)
    assert np.all(np.diff(run.trajectory.timestamps) > 0)


def test_one_wrong_stamp_costs_one_frame(room, frames, config):
    shown = [frames[0], replace(frames[1], timestamp=1e9), *frames[2:5]]
    run = slam.run(enumerate(shown), room.camera, config)
    assert (run.num_frames, run.num_skipped) == (5, 1)
    assert run.trajectory.timestamps[-1] == frames[4].timestamp


def test_the_map_grows_when_it_is_full(room, frames, config):
    tight = replace(config, mapping=replace(config.mapping, capacity=512))
    state, _ = slam.step(slam.init(room.camera, tight), frames[0])
    roomy, _ = slam.step(slam.init(room.camera, config), frames[0])
    assert state.mapping.dropped_seeds == 0
    assert state.gaussians.valid.shape[0] > 1024, "it grew more than once"
    assert jnp.sum(state.gaussians.valid) == jnp.sum(roomy.gaussians.valid)


def test_a_map_at_its_limit_reports_what_did_not_fit(room, frames, config):
    tight = replace(config, mapping=replace(config.mapping, capacity=512, max_capacity=1024))
    state, _ = slam.step(slam.init(room.camera, tight), frames[0])
    roomy, _ = slam.step(slam.init(room.camera, config), frames[0])
    assert jnp.sum(state.gaussians.valid) == 1024
    assert state.mapping.dropped_seeds == int(jnp.sum(roomy.gaussians.valid)) - 1024


def test_too_few_pairs_are_made_room_for(room, frames, config):
    often = replace(config.mapping, view_interval=1)
    states = []
    for mapping in (often, replace(often, pair_capacity=128)):
        state = slam.init(room.camera, replace(config, mapping=mapping))
        # The first view finds no Gaussians, and so no pairs.
        for frame in frames[:2]:
            state, _ = slam.step(state, frame)
        states.append(state)
    roomy, tight = states
    assert tight.mapping.pair_capacity > 128
    np.testing.assert_allclose(tight.gaussians.means, roomy.gaussians.means, atol=1e-5)


def test_frames_that_were_left_out_are_not_lost(room, frames, config):
    """Numbers jump where frames were dropped or could not be decoded: the motion model goes on."""
    state = slam.init(room.camera, config)
    for number, frame in ((0, frames[0]), (1, frames[1]), (9, frames[2])):
        state, info = slam.step(state, frame, number=number)
        assert info.tracked
    assert int(state.tracker.lost_in_a_row) == 0
    assert list(state.log.numbers) == [0, 1, 9]
    assert state.num_lost == 0
    assert state.next_frame == 10
