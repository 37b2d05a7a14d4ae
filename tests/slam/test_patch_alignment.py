"""Places of matched keypoints by the images around them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from sfgs_jax.slam.frontend import PatchPairs, aligned

STEPS = 5
SHIFT = np.asarray([0.73, -1.41])
"""From where the source's keypoints were detected to where they are, pixels."""


@pytest.fixture
def image(rng):
    """A smooth texture."""
    return gaussian_filter(rng.normal(size=(120, 160)), 2.0) + 0.5


def pairs_of(image, rng, *, warp=None, gain=1.0, offset=0.0, noise=0.0):
    """A source that shows the target turned or scaled about each of its keypoints, and moved.

    It is interpolated linearly, which moves things by some hundredths of a pixel by itself.
    """
    warp = np.eye(2) if warp is None else warp
    target_places = np.stack(np.meshgrid(np.arange(20.0, 150, 12), np.arange(16.0, 110, 12))).reshape(2, -1)
    places = target_places.round() + rng.uniform(-0.5, 0.5, target_places.shape)
    v, u = np.mgrid[0:120, 0:160].astype(float)
    source = np.zeros_like(image)
    # Each pixel belongs to the nearest keypoint.
    near = np.argmin((u[..., None] - target_places[0]) ** 2 + (v[..., None] - target_places[1]) ** 2, axis=-1)
    true = places + SHIFT[:, None]
    off = np.stack([u - true[0][near], v - true[1][near]])
    at = target_places[:, near] + np.einsum("ij,jhw->ihw", warp, off)
    source = gain * map_coordinates(image, at[::-1], order=1, mode="nearest") + offset
    source += rng.normal(scale=noise, size=source.shape) if noise else 0
    count = places.shape[1]
    warps = np.tile(warp[:, :, None], (1, 1, count))
    known = (source, image, places, target_places, warps, 1.0)
    return PatchPairs._make(jnp.asarray(x, jnp.float32) for x in known)


TURNED = 0.9 * np.asarray([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])


@pytest.mark.parametrize(
    ("how", "within"),
    [
        ({}, 0.07),
        ({"warp": TURNED}, 0.07),
        ({"gain": 0.7, "offset": 0.2}, 0.07),
        ({"noise": 0.01}, 0.1),
    ],
)
def test_places_are_found_to_a_part_of_a_pixel(image, rng, how, within):
    found = aligned(pairs_of(image, rng, **how), steps=STEPS)
    off = np.abs(np.asarray(found.shift) - SHIFT[:, None]).max(axis=0)
    assert np.median(off) < within
    assert np.mean(off < 3 * within) > 0.9
    assert np.mean(np.asarray(found.agreement) > 0.9) > 0.9


def test_faint_patches_find_what_was_detected_pixels_off(image, rng):
    """A Gaussian pull of a pixel back to where they were detected would leave two fifths of the shift."""
    found = aligned(pairs_of(0.5 + 0.1 * (image - 0.5), rng), steps=60)
    share = SHIFT @ np.asarray(found.shift) / (SHIFT @ SHIFT)
    assert np.median(share) == pytest.approx(0.8, abs=0.05)


def test_patches_of_other_things_do_not_agree(image, rng):
    pairs = pairs_of(image, rng)
    others = pairs._replace(target_places=jnp.roll(pairs.target_places, 7, axis=1))
    assert np.mean(np.asarray(aligned(others, steps=STEPS).agreement) > 0.8) < 0.1


def test_what_has_no_contrast_or_no_image_agrees_with_nothing(image, rng):
    pairs = pairs_of(image, rng)
    for blank in (
        pairs._replace(source=jnp.zeros_like(pairs.source)),
        pairs._replace(target=jnp.zeros_like(pairs.target)),
        pairs._replace(target_places=pairs.target_places + 1e4),
    ):
        found = aligned(blank, steps=STEPS)
        assert np.all(np.isfinite(found.shift))
        np.testing.assert_allclose(found.agreement, 0, atol=1e-5)
        slope = jax.grad(lambda source, pairs=blank: shifts(source, pairs))(blank.source)
        assert np.all(np.isfinite(slope))


def shifts(source, pairs):
    return jnp.sum(aligned(pairs._replace(source=source), steps=60).shift)


def test_without_contrast_a_keypoint_stays_where_it_was_detected(image, rng):
    pairs = pairs_of(image, rng)
    # An edge: its place along itself is told by the detection alone.
    edge = jnp.asarray(np.tile(1 / (1 + np.exp(-(np.arange(160) - 80.3))), (120, 1)), jnp.float32)
    rows = jnp.linspace(30, 90, pairs.places.shape[1])
    detected, known = (jnp.stack([jnp.full_like(rows, u), rows]) for u in (80.0, 81.5))
    found = aligned(
        pairs._replace(source=edge, target=edge, places=detected, target_places=known), steps=STEPS
    )
    np.testing.assert_allclose(found.shift[0], 1.5, atol=0.05)
    np.testing.assert_allclose(found.shift[1], 0, atol=0.05)


def test_what_reaches_the_limit_is_no_rounding_away_from_counting(image, rng):
    """A pose is told from these shifts once, and its derivative from the places that they lead to."""
    pairs = pairs_of(image, rng)
    # Farther off than the limit of three pixels, some come to rest at it.
    found = aligned(pairs._replace(places=pairs.places - 2 * SHIFT[:, None]), steps=60)
    left_out = np.asarray(found.agreement) == 0
    farthest = np.abs(np.asarray(found.shift)).max(axis=0)
    assert np.mean(left_out) > 0.1
    assert np.all(farthest[left_out] > 3.1)
    assert np.all(farthest[~left_out] < 3.0)
