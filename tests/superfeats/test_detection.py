import jax
import jax.numpy as jnp
import numpy as np

from sfgs_jax.superfeats.detection import heat_map, local_maxima, refine, strongest


def test_the_heat_map_is_a_softmax_laid_out_by_cells(rng):
    logits = rng.normal(size=(2, 3, 65)).astype(np.float32)
    heat = np.asarray(heat_map(jnp.asarray(logits)))
    expected = jax.nn.softmax(logits)
    for row in range(16):
        for column in range(24):
            place = 8 * (row % 8) + column % 8
            np.testing.assert_allclose(heat[row, column], expected[row // 8, column // 8, place], rtol=1e-5)


def test_extreme_logits_stay_finite():
    logits = jnp.full((1, 1, 65), -1e4).at[0, 0, 3].set(1e4)
    heat = heat_map(logits)
    assert float(heat[0, 3]) == 1.0
    assert bool(jnp.isfinite(heat).all())


def test_a_maximum_is_not_exceeded_within_two_pixels(rng):
    heat = rng.random((20, 30)).astype(np.float32)
    found = np.asarray(local_maxima(jnp.asarray(heat)))
    padded = np.pad(heat, 2)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (5, 5)).max((2, 3))
    np.testing.assert_array_equal(found, heat >= windows)


def test_the_strongest_come_first_and_gaps_are_filled():
    scores = jnp.zeros((3, 4)).at[1, 2].set(0.5).at[2, 0].set(0.9)
    found, pixels = strongest(scores, count=20)
    assert found.shape == (20,)
    np.testing.assert_allclose(found[:3], [0.9, 0.5, 0])
    np.testing.assert_array_equal(pixels[:2], [[0, 2], [2, 1]])


def test_a_peak_between_pixels_is_found_there():
    v, u = np.mgrid[:15, :15]
    centre = np.array([7.3, 6.8])
    heat = np.exp(-((u - centre[0]) ** 2 + (v - centre[1]) ** 2) / (2 * 0.6**2)).astype(np.float32)
    refined = refine(jnp.asarray(heat), jnp.asarray([[7.0, 7.0]]))
    np.testing.assert_allclose(refined[0], centre, atol=0.05)


def test_refining_stays_within_a_pixel_and_finite_at_borders_and_without_heat(rng):
    pixels = jnp.asarray([[0.0, 0.0], [9.0, 0.0], [9.0, 7.0], [4.0, 4.0]])
    for heat in (jnp.zeros((8, 10)), jnp.asarray(rng.random((8, 10)), jnp.float32)):
        shift = refine(heat, pixels) - pixels
        assert float(jnp.abs(shift).max()) <= 1.0


def test_the_refined_position_has_the_centroids_gradient():
    heat = jnp.asarray(np.random.default_rng(1).random((5, 5)))
    at = jnp.asarray([[2.0, 2.0]])
    gradient = np.asarray(jax.grad(lambda heat: refine(heat, at)[0, 0])(heat))
    step = 1e-3
    for row, column in [(2, 1), (2, 3), (1, 1), (3, 3), (0, 0)]:
        moved = [refine(heat.at[row, column].add(sign * step), at)[0, 0] for sign in (1, -1)]
        np.testing.assert_allclose(gradient[row, column], (moved[0] - moved[1]) / (2 * step), atol=1e-3)
