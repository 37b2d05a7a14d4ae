"""Comparison of two images under a motion: what speaks against it, and what does not."""

from dataclasses import replace

import cv2
import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import Camera, Frame
from sfgs_jax.geometry import se3
from sfgs_jax.gicp import GicpConfig
from sfgs_jax.slam import (
    FeaturesConfig,
    PoseSource,
    TrackingConfig,
    init_tracker,
    observe,
    register,
    track,
    tracker_params,
)
from sfgs_jax.slam.frontend import Allowed, allowed_sources, image_correlation, images_look_alike

CAMERA = Camera(160.0, 160.0, 79.5, 59.5, width=160, height=120)
SHIFT = (0.12, -0.04, 0.0)


def wall(image, shift=(0, 0, 0)):
    """A wall two metres ahead, from a camera moved along it: 1 cm of the wall in each texel."""
    u, v = np.meshgrid(np.arange(160), np.arange(120))
    x, y = (2 * (u - 79.5) / 160 + shift[0], 2 * (v - 59.5) / 160 + shift[1])
    column, row = ((150 + 100 * z).astype(np.float32) for z in (x, y))
    grey = cv2.remap(image, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    return Frame(np.repeat(grey[..., None], 3, -1), np.full((120, 160), 2.0, np.float32), 0.0)


@pytest.fixture
def image(rng):
    """Coloured patches of 4 and 25 cm."""
    fine, coarse = (np.kron(rng.random((n, n)), np.ones((k, k))) for n, k in ((75, 4), (12, 25)))
    return ((fine + coarse) / 2).astype(np.float32)


@pytest.fixture
def params(config):
    return tracker_params(CAMERA, config.tracking)


@pytest.fixture
def correlation(params):
    """Correlation of two frames under a shift of the camera."""

    def judged(source, target, shift=SHIFT):
        T = se3.exp(jnp.asarray([*shift, 0.0, 0.0, 0.0], jnp.float32))
        return float(image_correlation(observe(params, source), observe(params, target), T))

    return judged


def changed(frame, change):
    return replace(frame, rgb=np.clip(change(frame.rgb), 0, 1).astype(np.float32))


def covered(frame, share, rng):
    """The frame with something else in its left part."""
    other = np.kron(rng.random((12, 16, 1)), np.ones((10, 10, 3)))
    inside = np.arange(160)[None, :, None] < share * 160
    return changed(frame, lambda rgb: np.where(inside, other, rgb))


def test_images_look_alike_under_their_motion_and_under_no_other(image, correlation):
    source, target = wall(image, SHIFT), wall(image)
    assert correlation(source, target) > 0.98
    assert correlation(source, target, (-0.2, -0.04, 0.0)) < 0.5
    assert correlation(source, target, (0.12, 0.3, 0.0)) < 0.5


def test_another_wall_does_not_look_alike(rng, image, correlation):
    other = rng.permutation(image.reshape(-1, 25, 300)).reshape(300, 300)
    assert correlation(wall(other, SHIFT), wall(image)) < 0.5


@pytest.mark.parametrize(
    "change",
    [
        lambda rgb: 0.5 * rgb,
        lambda rgb: 0.3 + 0.6 * rgb,
        lambda rgb: cv2.blur(rgb, (9, 1)),
        lambda rgb: rgb + np.random.default_rng(1).normal(0, 0.08, rgb.shape),
    ],
    ids=["darker", "brighter", "moved while exposed", "noise"],
)
def test_exposure_blur_and_noise_change_little(image, correlation, change):
    assert correlation(changed(wall(image, SHIFT), change), wall(image)) > 0.93


@pytest.mark.parametrize(("share", "expected"), [(0.35, True), (0.75, False)])
def test_something_that_moves_may_cover_less_than_half(rng, image, correlation, share, expected):
    least = TrackingConfig().min_image_correlation
    assert (correlation(covered(wall(image, SHIFT), share, rng), wall(image)) > least) == expected


def test_it_is_one_where_there_is_nothing_to_compare(image, correlation):
    bare = changed(wall(image), lambda rgb: np.full_like(rgb, 0.4))
    assert correlation(bare, wall(image)) == 1
    assert correlation(wall(image, SHIFT), wall(image), (9.0, 0.0, 0.0)) == 1
    blind = replace(wall(image), depth=np.zeros((120, 160), np.float32))
    assert correlation(blind, wall(image), (-0.2, -0.04, 0.0)) == 1


def test_it_is_one_where_no_images_are_kept(config, image):
    features = replace(config.tracking.features, align_patches=False)
    params = tracker_params(CAMERA, replace(config.tracking, features=features))
    source, target = observe(params, wall(image, SHIFT)), observe(params, wall(image))
    astray = se3.exp(jnp.asarray([-0.2, -0.04, 0.0, 0.0, 0.0, 0.0], jnp.float32))
    assert float(image_correlation(source, target, astray)) == 1


def test_one_image_is_exactly_like_itself(params, image):
    seen = observe(params, wall(image))
    np.testing.assert_allclose(image_correlation(seen, seen, se3.identity()), 1, atol=1e-5)


@pytest.mark.parametrize(
    ("sure", "may_differ", "expected"),
    [(1.0, False, PoseSource.LOST), (1.0, True, PoseSource.JOINT), (0.0, False, PoseSource.JOINT)],
)
def test_a_pose_is_lost_where_images_differ_that_may_not(config, image, sure, may_differ, expected):
    """No two images are as much alike as is asked for here. Sure keypoints are not asked."""
    features = replace(config.tracking.features, min_inlier_share_sure=sure)
    tracking = replace(config.tracking, features=features, min_image_correlation=1.0)
    params = tracker_params(CAMERA, tracking)
    source, target = observe(params, wall(image, SHIFT)), observe(params, wall(image))
    found = register(params, source, target, se3.identity(), Allowed(images=may_differ))
    assert int(found.matched.num_inliers) < int(found.matched.num_detected)
    assert int(found.source) == expected


def test_far_from_the_guess_half_as_much_may_differ():
    config = TrackingConfig(min_image_correlation=0.8)
    for correlation, near, far in [(0.79, False, False), (0.85, True, False), (0.91, True, True)]:
        assert bool(images_look_alike(jnp.asarray(correlation), config, near_guess=True)) == near
        assert bool(images_look_alike(jnp.asarray(correlation), config, near_guess=False)) == far


@pytest.mark.parametrize(("before", "expected"), [(0.0, True), (0.9, True), (0.95, False)])
def test_images_may_differ_until_one_has_looked_like_its_reference(config, before, expected):
    """In fog no two do."""
    tracking = replace(config.tracking, min_image_correlation=0.85)
    tracker = init_tracker(tracker_params(CAMERA, tracking))
    tracker = eqx.tree_at(lambda t: t.last_registration.image_correlation, tracker, jnp.asarray(before))
    assert bool(allowed_sources(tracker, tracking).images) == expected


@pytest.fixture(scope="module")
def never_sure():
    """Parameters by which no keypoints are sure."""
    features = FeaturesConfig(max_keypoints=256, max_rigid_matches=128, min_inlier_share_sure=1.0)
    gicp = GicpConfig(levels=1, strides=(1,))
    return tracker_params(CAMERA, TrackingConfig(features=features, gicp=gicp))


@pytest.mark.parametrize(
    ("share", "expected"), [(0.0, [True, True, False]), (0.6, [True, False, False])], ids=["alike", "unlike"]
)
def test_a_camera_whose_velocity_is_unknown_is_as_fast_as_images_say(never_sure, image, rng, share, expected):
    """A millisecond lies between frames. It goes 126 m/s, then half of the way back."""
    half = tuple(x / 2 for x in SHIFT)
    sequence = wall(image), covered(wall(image, SHIFT), share, rng), wall(image, half)
    tracker, tracked, elapsed = init_tracker(never_sure), [], jnp.asarray(0.001)
    for frame in sequence:
        tracker, info = track(never_sure, tracker, jnp.asarray(frame.rgb), jnp.asarray(frame.depth), elapsed)
        tracked.append(bool(info.tracked))
    assert tracked == expected
