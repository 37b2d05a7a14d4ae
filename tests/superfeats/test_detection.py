"""Detection, step by step, on maps whose keypoints are known."""

import jax
import jax.numpy as jnp
import numpy as np

from sfgs_jax.superfeats.detection import (
    away_from_border,
    cut,
    heat_map,
    hottest_near,
    local_maxima,
    refine,
    strongest,
)

# One program for each instead of one for each operation.
refined_near = jax.jit(refine)
hottest = jax.jit(hottest_near, static_argnames="reach")
strongest_of = jax.jit(strongest, static_argnames="count")
maxima_of = jax.jit(local_maxima)


def by_place(image: np.ndarray) -> jax.Array:
    """(8 r, 8 c) pixels as (8, 8, r, c)."""
    h, w = image.shape
    return jnp.asarray(image.reshape(h // 8, 8, w // 8, 8).transpose(1, 3, 0, 2))


def as_image(x: jax.Array) -> np.ndarray:
    """The other way round."""
    _, _, rows, columns = x.shape
    return np.asarray(x).transpose(2, 0, 3, 1).reshape(8 * rows, 8 * columns)


def test_the_heat_map_is_a_softmax_laid_out_by_places(rng):
    logits = rng.normal(size=(65, 2, 3)).astype(np.float32)
    heat = as_image(jax.jit(heat_map)(jnp.asarray(logits)))
    expected = jax.nn.softmax(logits, axis=0)
    for row in range(16):
        for column in range(24):
            place = 8 * (row % 8) + column % 8
            np.testing.assert_allclose(heat[row, column], expected[place, row // 8, column // 8], rtol=1e-5)


def test_extreme_logits_stay_finite():
    logits = jnp.full((65, 1, 1), -1e4).at[3].set(1e4)
    heat = jax.jit(heat_map)(logits)
    assert float(heat[0, 3, 0, 0]) == 1.0
    assert bool(jnp.isfinite(heat).all())


def test_beyond_the_image_there_is_no_heat(rng):
    image = rng.random((24, 32)).astype(np.float32)
    for height, width in [(24, 32), (24, 25), (17, 32), (9, 3)]:
        expected = np.zeros_like(image)
        expected[:height, :width] = image[:height, :width]
        np.testing.assert_array_equal(as_image(cut(by_place(image), height, width)), expected)


def test_pixels_away_from_the_border_are_told_in_images_that_do_not_fill_their_cells():
    heat = by_place(np.zeros((24, 32), np.float32))
    for height, width in [(24, 32), (21, 27), (17, 32), (7, 9)]:
        expected = np.zeros((24, 32), bool)
        expected[4 : height - 4, 4 : width - 4] = True
        np.testing.assert_array_equal(as_image(away_from_border(heat, height, width)), expected)


def test_a_maximum_is_not_exceeded_within_two_pixels(rng):
    heat = rng.random((24, 32)).astype(np.float32)
    found = as_image(maxima_of(by_place(heat)))
    padded = np.pad(heat, 2)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (5, 5)).max((2, 3))
    np.testing.assert_array_equal(found, heat >= windows)


def test_the_strongest_come_first_and_gaps_are_filled():
    scores = np.zeros((8, 16), np.float32)
    scores[1, 2], scores[2, 9], scores[7, 15] = 0.5, 0.9, 0.7
    found, pixels = strongest_of(by_place(scores), count=40)
    assert found.shape == (40,)
    np.testing.assert_allclose(found[:4], [0.9, 0.7, 0.5, 0])
    np.testing.assert_array_equal(pixels[:3], [[9, 2], [15, 7], [2, 1]])


def test_every_maximum_is_among_the_strongest(rng):
    heat = rng.random((24, 32)).astype(np.float32)
    scores = np.where(as_image(maxima_of(by_place(heat))), heat, 0)
    found, pixels = strongest_of(by_place(scores), count=200)
    u, v = np.asarray(pixels, int)[np.asarray(found) > 0].T
    assert {*zip(v.tolist(), u.tolist(), strict=True)} == {*map(tuple, np.argwhere(scores).tolist())}
    np.testing.assert_array_equal(found[: len(u)], scores[v, u])


def test_a_peak_between_pixels_is_found_there():
    v, u = np.mgrid[:16, :16]
    centre = np.array([7.3, 6.8])
    heat = np.exp(-((u - centre[0]) ** 2 + (v - centre[1]) ** 2) / (2 * 0.6**2)).astype(np.float32)
    refined = refined_near(by_place(heat), jnp.asarray([[7.0, 7.0]]))
    np.testing.assert_allclose(refined[0], centre, atol=0.05)


def test_the_hottest_pixel_nearby_is_found_and_none_beyond_reach_or_image():
    heat = np.full((16, 24), 0.1, np.float32)
    heat[4, 9], heat[9, 20], heat[0, 0] = 0.5, 0.9, 0.4
    pixels = jnp.asarray([[7.0, 6.0], [17.0, 9.0], [16.0, 9.0], [2.0, 1.0], [23.0, 12.0]])
    found = np.asarray(hottest(by_place(heat), pixels, reach=3))
    np.testing.assert_array_equal(found[[0, 1, 3, 4]], [[9, 4], [20, 9], [0, 0], [20, 9]])
    assert not np.array_equal(found[2], [20, 9])


def test_refining_stays_within_its_window_and_finite_at_borders_and_without_heat(rng):
    pixels = jnp.asarray([[0.0, 0.0], [15.0, 0.0], [15.0, 7.0], [4.0, 4.0]])
    for heat in (np.zeros((8, 16), np.float32), rng.random((8, 16)).astype(np.float32)):
        shift = refined_near(by_place(heat), pixels) - pixels
        assert float(jnp.abs(shift).max()) <= 2.0


def test_the_refined_position_has_the_centroids_gradient():
    heat = by_place(np.random.default_rng(1).random((8, 8)).astype(np.float32))
    at = jnp.asarray([[2.0, 2.0]])
    slope = jax.jit(jax.value_and_grad(lambda heat: refine(heat, at)[0, 0]))
    gradient = np.asarray(slope(heat)[1])
    step = 1e-3
    for place in [(2, 1), (2, 3), (1, 1), (3, 3), (0, 0)]:
        change = np.zeros_like(heat)
        change[*place, 0, 0] = step
        moved = [slope(heat + sign * change)[0] for sign in (1, -1)]
        np.testing.assert_allclose(gradient[*place, 0, 0], (moved[0] - moved[1]) / (2 * step), atol=1e-3)
