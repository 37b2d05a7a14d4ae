"""Registration by keypoints and surface: what carries it, and what the surface leaves free."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import Camera, Frame, slam
from sfgs_jax.geometry import se3
from sfgs_jax.slam import PoseSource, observe, register, tracker_params
from sfgs_jax.slam.frontend import motion_from_keypoints, num_explained

# Of the size of the room's images: the intrinsics are no constants of the compiled programs.
CAMERA = Camera(160.0, 160.0, 79.5, 59.5, width=160, height=120)
SHIFT = (0.06, -0.03, 0.0)


def texture(rng):
    """Coloured patches of several sizes, 2 cm to 20 cm."""
    fine = np.kron(rng.random((75, 75)), np.ones((4, 4)))
    coarse = np.kron(rng.random((12, 12)), np.ones((25, 25)))
    return ((fine + coarse) / 2).astype(np.float32)


def wall(image, shift, *, bare=False):
    """A wall two metres ahead, from a camera moved along it: 1 cm of the wall in each texel."""
    u, v = np.meshgrid(np.arange(160), np.arange(120))
    x, y = (2 * (u - 79.5) / 160 + shift[0], 2 * (v - 59.5) / 160 + shift[1])
    column, row = ((np.clip((z + 1.5) * 100, 0, 298)) for z in (x, y))
    i, j = row.astype(int), column.astype(int)
    a, b = row - i, column - j
    grey = (
        image[i, j] * (1 - a) * (1 - b)
        + image[i + 1, j] * a * (1 - b)
        + image[i, j + 1] * (1 - a) * b
        + image[i + 1, j + 1] * a * b
    )
    grey = np.full_like(grey, 0.5) if bare else grey
    depth = np.full((120, 160), 2.0 + shift[2], np.float32)
    return Frame(np.repeat(grey[..., None], 3, -1).astype(np.float32), depth, 0.0)


@pytest.fixture
def tracking(config):
    return config.tracking


@pytest.fixture
def params(tracking):
    return tracker_params(CAMERA, tracking)


@pytest.fixture
def made_up(tracking):
    """Parameters for keypoints whose places and points are made up: no image shows them."""
    return tracker_params(CAMERA, replace(tracking, features=replace(tracking.features, align_patches=False)))


@pytest.fixture
def look(params):
    return lambda frame: observe(params, frame)


@pytest.fixture
def corner(look):
    """Depth of a corner of three planes, and how to look at a depth without an image."""
    rays = np.asarray(CAMERA.unproject(CAMERA.pixels(), jnp.ones(CAMERA.shape)))
    normals = np.asarray([[0.8, 0.1, 1.0], [-0.7, 0.3, 1.0], [0.0, -0.9, 1.0]])
    depth = (2 / np.max(rays @ normals.T, axis=-1)).astype(np.float32)
    blank = np.zeros((*CAMERA.shape, 3), np.float32)
    return (lambda depth: look(Frame(blank, depth, 0.0))), depth


def test_along_a_textured_wall_the_keypoints_decide(rng, look, params):
    image = texture(rng)
    source, target = look(wall(image, SHIFT)), look(wall(image, (0, 0, 0)))
    found = register(params, source, target, se3.identity())
    assert int(found.source) == PoseSource.JOINT
    assert int(found.num_free) == 3
    np.testing.assert_allclose(found.T_target_source.wxyz_xyz[4:], SHIFT, atol=0.01)
    assert np.linalg.norm(se3.log(found.T_target_source)[3:]) < 0.01
    # Both say how sure they are, and only together are they sure of every direction.
    surface, both = (
        np.linalg.eigvalsh(np.asarray(x)) for x in (found.surface_information, found.information)
    )
    assert surface[0] < 1e-3 * surface[-1]
    assert both[0] > 100


@pytest.mark.parametrize(("wrong", "expected"), [(0.4, PoseSource.JOINT), (0.82, PoseSource.LOST)])
def test_keypoints_decide_alone_only_if_enough_of_them_agree(rng, look, made_up, tracking, wrong, expected):
    """Nor does the motion model against so many that fit no motion."""
    image = texture(rng)
    source, target = look(wall(image, SHIFT)), look(wall(image, (0, 0, 0)))
    points = target.keypoints.points
    astray = jnp.asarray(rng.random(len(points)) < wrong)
    points = jnp.where(astray[:, None], points[rng.permutation(len(points))], points)
    target = eqx.tree_at(lambda o: o.keypoints.points, target, points)
    guess = se3.exp(jnp.asarray([0.05, -0.02, 0.0, 0.0, 0.0, 0.0]))
    found = register(made_up, source, target, guess)
    agreeing = int(found.matched.num_inliers) / int(found.matched.num_matches)
    assert (agreeing > tracking.features.min_inlier_share_alone) == (expected == PoseSource.JOINT)
    assert agreeing > tracking.features.min_inlier_share
    assert int(found.source) == expected
    expected = SHIFT if expected == PoseSource.JOINT else (0.05, -0.02, 0.0)
    np.testing.assert_allclose(found.T_target_source.wxyz_xyz[4:], expected, atol=0.01)


def thinned(params, frame, target, keep):
    """The registration of a frame by so many of its keypoints, of those that fit."""
    seen = observe(params, frame)
    inliers = register(params, seen, target, se3.identity()).matched.inliers
    kept = seen.keypoints.features.valid & inliers & (jnp.cumsum(inliers) <= keep)
    seen = eqx.tree_at(lambda o: o.keypoints.features.valid, seen, kept)
    return register(params, seen, target, se3.identity())


@pytest.mark.parametrize("enough", [True, False])
def test_few_keypoints_help_a_surface_but_do_not_stand_without_it(
    rng, look, params, tracking, corner, enough
):
    few, many = tracking.features.min_inliers, tracking.features.min_inliers_alone
    rgb, (_, depth) = wall(texture(rng), (0, 0, 0)).rgb, corner
    target, keep = look(Frame(rgb, depth, 0.0)), many + 10 if enough else (few + many) // 2
    both = thinned(params, Frame(rgb, depth, 0.0), target, keep)
    alone = thinned(params, Frame(rgb, np.zeros_like(depth), 0.0), target, keep)
    assert int(both.num_free) == 0
    assert int(both.source) == PoseSource.JOINT
    assert int(alone.source) == (PoseSource.KEYPOINTS if enough else PoseSource.LOST)
    np.testing.assert_allclose(se3.log(both.T_target_source), 0, atol=0.005)
    for result in (both, alone):
        assert (int(result.matched.num_inliers) >= many) == enough
        assert int(result.matched.num_inliers) >= few


@pytest.mark.parametrize(("sure", "expected"), [(True, PoseSource.KEYPOINTS), (False, PoseSource.LOST)])
def test_only_keypoints_that_are_sure_stand_against_a_surface(rng, look, made_up, corner, sure, expected):
    """Points of a part of the keypoints are 20 cm aside, the others' are anywhere."""
    rgb, (_, depth) = wall(texture(rng), (0, 0, 0)).rgb, corner
    seen = look(Frame(rgb, depth, 0.0))
    points = seen.keypoints.points
    aside = jnp.asarray(rng.random(len(points)) < (0.8 if sure else 0.25))
    points = jnp.where(
        aside[:, None], points + jnp.asarray([[0.2, 0, 0]]), points[rng.permutation(len(points))]
    )
    target = eqx.tree_at(lambda o: o.keypoints.points, seen, points)
    found = register(made_up, seen, target, se3.identity())
    assert int(found.matched.num_inliers) >= 20
    np.testing.assert_allclose(found.matched.T_target_source.translation(), [0.2, 0, 0], atol=0.01)
    assert int(found.source) == expected


@pytest.mark.parametrize("enough", [True, False])
def test_what_a_wall_leaves_free_takes_as_many_keypoints_as_stand_alone(rng, look, params, tracking, enough):
    """All of the few agree, as do the outlines of a bare sphere that the camera circles."""
    image, many = texture(rng), tracking.features.min_inliers_alone
    target = look(wall(image, (0, 0, 0)))
    found = thinned(params, wall(image, SHIFT), target, many + 10 if enough else many - 4)
    assert int(found.matched.num_inliers) > tracking.features.min_inliers
    assert int(found.num_free) == 3
    assert int(found.source) == (PoseSource.JOINT if enough else PoseSource.MOTION_MODEL)


@pytest.mark.parametrize(
    ("shown", "fraction", "expected"),
    [("nothing", 1.0, PoseSource.SURFACE), ("another", 0.45, PoseSource.LOST)],
)
def test_what_the_reference_does_not_show_is_no_reason_to_doubt_a_surface(
    corner, params, shown, fraction, expected
):
    """The reference shows half of a corner of three planes; the rest is missing, or something else."""
    look, depth = corner
    part = depth.copy()
    part[60:] = 0 if shown == "nothing" else part[60:] - 0.1
    found = register(params, look(depth), look(part), se3.identity())
    assert float(found.inlier_fraction) == pytest.approx(fraction, abs=0.06)
    assert int(found.num_free) == 0
    assert int(found.source) == expected


def test_inliers_that_another_motion_explains_are_counted(rng, look, params):
    image = texture(rng)
    source, target = look(wall(image, SHIFT)), look(wall(image, (0, 0, 0)))
    matched = motion_from_keypoints(source, target, se3.identity(), params)

    @jax.jit
    def explained(T):
        return num_explained(T, matched, source.keypoints, target.keypoints, params)

    assert explained(matched.T_target_source) == int(matched.num_inliers) > 50
    assert explained(se3.identity()) == 0  # five pixels away


def test_places_by_patches_weigh_by_their_own_noise(rng, look, tracking):
    """By that of the detector's places a quarter would be known along the wall."""
    image = texture(rng)
    source, target = look(wall(image, SHIFT)), look(wall(image, (0, 0, 0)))
    detected = replace(tracking.features, patch_sigma=1.0, patch_kernel_width=3.0)
    settings = tracking.features, detected, replace(detected, align_patches=False)
    by_patches, as_detected, unaligned = (
        motion_from_keypoints(
            source, target, se3.identity(), tracker_params(CAMERA, replace(tracking, features=features))
        )
        for features in settings
    )
    along = [np.diag(found.information)[:2] for found in (by_patches, as_detected)]
    np.testing.assert_allclose(along[0], along[1] / tracking.features.patch_sigma**2, rtol=0.1)
    off = se3.log(
        se3.compose(se3.inverse(se3.exp(jnp.asarray([*SHIFT, 0, 0, 0]))), by_patches.T_target_source)
    )
    assert np.asarray(off) @ np.asarray(by_patches.information) @ np.asarray(off) < 12.6
    # The motion that the patches are laid over each other by is that of the detector's places.
    for found in (by_patches, as_detected):
        np.testing.assert_array_equal(found.T_as_detected.wxyz_xyz, unaligned.T_target_source.wxyz_xyz)


def test_along_a_bare_wall_the_guess_stays_and_is_named(rng, look, params):
    image = texture(rng)
    source, target = look(wall(image, SHIFT, bare=True)), look(wall(image, (0, 0, 0.05), bare=True))
    guess = se3.exp(jnp.asarray([0.02, 0.01, 0.0, 0.0, 0.0, 0.0]))
    found = register(params, source, target, guess)
    assert int(found.source) == PoseSource.MOTION_MODEL
    assert int(found.num_free) == 3
    np.testing.assert_allclose(found.T_target_source.wxyz_xyz[4:], [0.02, 0.01, 0.05], atol=0.004)


@pytest.fixture
def patient(config):
    """Settings with which a pose may rest on the motion model, which is uncertain to decimetres."""
    return replace(config, tracking=replace(config.tracking, max_position_sigma=0.5))


@pytest.mark.parametrize(("speed", "coasted"), [(0.03, 4), (0.06, 2)])
def test_where_the_wall_turns_bare_the_motion_model_carries_so_far_and_no_farther(
    rng, patient, speed, coasted
):
    image = texture(rng)
    state = slam.init(CAMERA, patient)
    sources, found = [], []
    for number in range(20):
        frame = wall(image, (speed * number, 0, 0), bare=number > 4)
        state, info = slam.step(state, frame)
        sources.append(info.source)
        found.append(float(info.T_world_cam.translation()[0]))
    assert sources[1:5] == [PoseSource.JOINT] * 4
    assert sources[5 : 5 + coasted] == [PoseSource.MOTION_MODEL] * coasted
    assert set(sources[5 + coasted :]) == {PoseSource.LOST}
    # At constant speed the model is right.
    np.testing.assert_allclose(found[: 5 + coasted], speed * np.arange(5 + coasted), atol=0.02)


def test_what_the_motion_model_alone_says_is_too_uncertain_by_default(rng, config):
    image = texture(rng)
    state = slam.init(CAMERA, config)
    for number in range(8):
        state, info = slam.step(state, wall(image, (0.02 * number, 0, 0), bare=number > 4))
        assert info.tracked == (number <= 4)


def test_the_motion_model_carries_no_frame_after_a_lost_one(rng, patient):
    image = texture(rng)
    state = slam.init(CAMERA, patient)
    dark = Frame(np.zeros((120, 160, 3), np.float32), np.zeros((120, 160), np.float32), 0.0)
    frames = [wall(image, (0.02 * number, 0, 0), bare=number > 2) for number in range(5)]
    sources = []
    for frame in [*frames[:4], dark, frames[4], frames[2]]:
        state, info = slam.step(state, frame)
        sources.append(info.source)
    assert sources[1:4] == [PoseSource.JOINT, PoseSource.JOINT, PoseSource.MOTION_MODEL]
    assert sources[4:] == [PoseSource.LOST, PoseSource.LOST, PoseSource.JOINT]


def test_a_motion_that_was_never_seen_carries_no_frame(rng, config):
    """A run begins at a bare wall, and the camera moves along it: that it stands still is only a guess."""
    image = texture(rng)
    state = slam.init(CAMERA, config)
    sources = []
    # The third frame shows the wall's texture, but nothing is known that it could be found in.
    for frame in [wall(image, (0.06 * number, 0, 0), bare=number < 2) for number in range(3)]:
        state, info = slam.step(state, frame)
        sources.append(info.source)
    assert sources == [PoseSource.JOINT, PoseSource.LOST, PoseSource.LOST]


def test_noise_on_a_bare_wall_is_no_keypoint(rng, look):
    bare = wall(texture(rng), SHIFT, bare=True)
    noisy = Frame(bare.rgb + rng.normal(scale=0.01, size=bare.rgb.shape).astype(np.float32), bare.depth, 0.0)
    assert not np.any(look(noisy).keypoints.features.valid)
    # It hides few keypoints of a textured wall.
    clear = wall(texture(rng), SHIFT)
    assert np.sum(look(clear).keypoints.features.valid) > 100


def test_shading_is_no_keypoint_and_what_lies_beside_bare_things_gives_them_none(rng, look):
    textured = wall(texture(rng), SHIFT)
    shade = np.linspace(0.2, 0.7, 160)[None, :, None] + np.linspace(0, 0.25, 120)[:, None, None]
    noise = rng.normal(scale=0.01, size=textured.rgb.shape)
    shaded = (shade + noise).astype(np.float32)
    assert not np.any(look(Frame(shaded, textured.depth, 0.0)).keypoints.features.valid)
    half = np.where(np.arange(160)[None, :, None] < 80, shaded, textured.rgb)
    features = look(Frame(half, textured.depth, 0.0)).keypoints.features
    column = np.asarray(features.keypoints)[np.asarray(features.valid), 0]
    assert np.sum(column > 80) > 40
    assert np.all(column > 80 - 8)


def test_keypoints_beside_an_edge_have_no_depth_and_those_on_a_slope_have(rng, look):
    frame = wall(texture(rng), SHIFT)
    step = np.where(np.arange(160) < 80, 1.5, 2.0) + np.zeros((120, 1))
    # A floor: the inverse of its depth is linear in the image, and falls by two thirds in it.
    slope = 1 / np.linspace(0.25, 0.75, 120)[:, None] + np.zeros(160)
    for depth, edge in ((step, True), (slope, False)):
        keypoints = look(Frame(frame.rgb, depth.astype(np.float32), 0.0)).keypoints
        column = np.asarray(keypoints.features.keypoints)[:, 0]
        near = np.asarray(keypoints.features.valid) & (np.abs(column - 79.5) < 3)
        far = np.asarray(keypoints.features.valid) & (np.abs(column - 79.5) > 6)
        assert near.sum() > 2
        assert np.all((np.asarray(keypoints.depth)[near] == 0) == edge)
        assert np.all(np.asarray(keypoints.depth)[far] > 0)


@pytest.mark.parametrize(
    ("dark", "blind", "expected"),
    [
        (False, False, PoseSource.JOINT),
        (True, False, PoseSource.SURFACE),
        (False, True, PoseSource.KEYPOINTS),
        (True, True, PoseSource.LOST),
    ],
)
def test_what_is_left_carries_the_frame(room, frames, config, dark, blind, expected):
    params = tracker_params(room.camera, config.tracking)
    frame = frames[1]
    rgb = np.zeros_like(frame.rgb) if dark else frame.rgb
    depth = np.zeros_like(frame.depth) if blind else frame.depth
    target = observe(params, frames[0])
    source = observe(params, Frame(rgb, depth, 0.0))
    found = register(params, source, target, se3.identity())
    if expected == PoseSource.SURFACE and int(found.num_free):
        # So small an image shows little of the room: the surface leaves a direction to the guess.
        expected = PoseSource.MOTION_MODEL
    assert int(found.source) == expected
    assert all(bool(jnp.all(jnp.isfinite(x))) for x in jax.tree.leaves(found))
    if expected != PoseSource.LOST:
        truth = np.linalg.inv(room.ground_truth.poses[0]) @ room.ground_truth.poses[1]
        error = np.linalg.inv(truth) @ np.asarray(se3.matrix(found.T_target_source))
        assert np.linalg.norm(error[:3, 3]) < 0.03
        assert np.degrees(np.arccos(min(1, (np.trace(error[:3, :3]) - 1) / 2))) < 1.5


@pytest.fixture
def known_matches(rng, look):
    """Keypoints of known depth that match by their descriptors, a third of them wrong, and the motion."""
    source, target = look(wall(texture(rng), SHIFT)), look(wall(texture(rng), (0, 0, 0)))
    k = target.keypoints.depth.size
    descriptors = np.eye(k, 64, dtype=np.float32) + rng.normal(size=(k, 64)).astype(np.float32) / 8
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
    pixels = rng.uniform([0, 0], [160, 120], (k, 2)).astype(np.float32)
    depth = rng.uniform(1, 3, k).astype(np.float32)
    points = np.asarray(CAMERA.unproject(jnp.asarray(pixels), jnp.asarray(depth)))
    T = se3.exp(jnp.asarray([0.1, -0.05, 0.08, 0.03, -0.06, 0.1]))
    seen = np.asarray(se3.transform(se3.inverse(T), jnp.asarray(points)))

    def keypoints(like, pixels, depth, points):
        found = replace(
            like.keypoints.features,
            keypoints=jnp.asarray(pixels),
            descriptors=jnp.asarray(descriptors),
            valid=jnp.ones(k, bool),
        )
        known = replace(like.keypoints, features=found, depth=jnp.asarray(depth), points=jnp.asarray(points))
        return replace(like, keypoints=known)

    wrong = np.arange(k) % 3 == 0
    where = np.array(CAMERA.project(jnp.asarray(seen)))
    where[wrong] = rng.uniform([0, 0], [160, 120], (int(wrong.sum()), 2))
    z = np.where(wrong, rng.uniform(1, 3, k), seen[:, 2]).astype(np.float32)
    z[::5] = 0
    moved = keypoints(source, where, z, CAMERA.unproject(jnp.asarray(where), jnp.asarray(np.maximum(z, 1))))
    return moved, keypoints(target, pixels, depth, points), T, wrong


def test_keypoints_give_the_motion_of_known_matches(known_matches, made_up):
    source, target, T, wrong = known_matches
    found = jax.jit(motion_from_keypoints)(source, target, se3.identity(), made_up)
    np.testing.assert_allclose(off(T, found.T_target_source), 0, atol=1e-4)
    assert int(found.num_inliers) >= 0.6 * len(wrong)
    seen, shown = source.keypoints, target.keypoints
    far = np.abs(seen.features.keypoints - shown.features.keypoints).max(1) > 60
    assert not np.any(np.asarray(found.inliers)[wrong & np.asarray((seen.depth > 0) & far)])


def off(a, b):
    return se3.log(se3.compose(se3.inverse(a), b))


@pytest.fixture
def noisy_matches(known_matches, rng):
    """The same, with noise that the kernel holds to be wrong in part: steps are many."""
    source, target, T, _ = known_matches
    pixels = source.keypoints.features.keypoints
    noisy = pixels + rng.normal(scale=2, size=pixels.shape).astype(np.float32)
    return eqx.tree_at(lambda s: s.keypoints.features.keypoints, source, noisy), target, T


def test_the_motion_of_the_keypoints_does_not_depend_on_its_start(noisy_matches, made_up):
    source, target, T = noisy_matches
    beside = se3.compose(T, se3.exp(jnp.asarray([0.01, -0.01, 0.01, 0.01, 0.01, -0.01])))
    find = jax.jit(motion_from_keypoints)
    ends = [find(source, target, start, made_up).T_target_source for start in (T, beside)]
    np.testing.assert_allclose(off(*ends), 0, atol=2e-5)
    assert np.abs(off(T, ends[0])).max() > 1e-3


def test_the_motion_of_the_keypoints_takes_few_steps(noisy_matches, tracking):
    source, target, T = noisy_matches
    beside = se3.compose(T, se3.exp(jnp.asarray([0.01, -0.01, 0.01, 0.01, 0.01, -0.01])))

    def found_in(steps):
        features = replace(tracking.features, align_patches=False, tolerance=1e-7, max_iterations=steps)
        params = tracker_params(CAMERA, replace(tracking, features=features))
        return jax.jit(motion_from_keypoints)(source, target, beside, params).T_target_source

    # Reweighted least squares alone are 6e-5 off then.
    np.testing.assert_allclose(off(found_in(8), found_in(300)), 0, atol=1e-5)


def test_the_motion_of_the_keypoints_has_the_slope_of_a_difference_in_reverse_mode(noisy_matches, tracking):
    source, target, T = noisy_matches
    features = replace(tracking.features, align_patches=False, tolerance=1e-7)
    params = tracker_params(CAMERA, replace(tracking, features=features))

    def along(points):
        moved = eqx.tree_at(lambda t: t.keypoints.points, target, points)
        found = motion_from_keypoints(source, moved, T, params)
        return se3.log(found.T_target_source) @ jnp.arange(1.0, 7)

    points = target.keypoints.points
    step = 1e-3 * points[:, ::-1]
    value_and_slopes = jax.jit(jax.value_and_grad(along))
    slope = jnp.sum(value_and_slopes(points)[1] * step)
    ends = [value_and_slopes(points + sign * step)[0] for sign in (1, -1)]
    assert float(slope) == pytest.approx(float(ends[0] - ends[1]) / 2, rel=0.02)
    assert abs(float(slope)) > 1e-4


def test_the_noise_of_the_targets_depth_is_no_motion(rng, look, tracking):
    """Errors of the motion are as large as its information says, with noise in both frames' measurements."""
    pixel, depth = 0.03, 0.003
    features = replace(
        tracking.features,
        align_patches=False,
        pixel_sigma=pixel,
        inverse_depth_sigma=depth,
        correlation=1.0,
        kernel_width=100.0,
    )
    params = tracker_params(CAMERA, replace(tracking, features=features))
    motion = se3.exp(jnp.asarray([0.25, 0.1, 0.1, 0.0, 0.02, 0.05]))
    seen = look(wall(texture(rng), (0, 0, 0)))
    count = len(seen.keypoints.points)
    # A slanted scene, and what a camera that moved sees of it without noise.
    rays = CAMERA.unproject(seen.keypoints.places, jnp.ones(count))
    points = rays * (1.5 + 0.3 * rays[:, :1] + 0.5 * jnp.asarray(rng.random((count, 1)), jnp.float32))
    moved = se3.transform(se3.inverse(motion), points)
    squares, find = [], jax.jit(motion_from_keypoints)
    for _ in range(60):
        noisy = points / (1 + depth * points[:, 2:] * jnp.asarray(rng.normal(size=(count, 1)), jnp.float32))
        places = CAMERA.project(moved) + pixel * jnp.asarray(rng.normal(size=(count, 2)), jnp.float32)
        measured = 1 / (1 / moved[:, 2] + depth * jnp.asarray(rng.normal(size=count), jnp.float32))
        target = eqx.tree_at(lambda o: o.keypoints.points, seen, noisy)
        source = eqx.tree_at(
            lambda o: (o.keypoints.features.keypoints, o.keypoints.depth), seen, (places, measured)
        )
        found = find(source, target, motion, params)
        off = np.asarray(se3.log(se3.compose(se3.inverse(motion), found.T_target_source)), float)
        squares.append(off @ np.asarray(found.information, float) @ off)
    # Six degrees of freedom: the mean of 60 squares has a deviation of 0.45.
    assert 4.5 < np.mean(squares) < 7.5
