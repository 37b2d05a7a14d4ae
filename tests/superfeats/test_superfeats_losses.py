"""Losses against direct sums and at their minima."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.superfeats.training import (
    contrastive_keypoint_loss,
    dual_softmax_loss,
    heat_loss,
    hinge_descriptor_loss,
    imitation_loss,
    keypoint_positions,
    reliability_loss,
    reprojection_loss,
    unit,
)

# One program for each instead of one for each operation.
reprojection = jax.jit(reprojection_loss, static_argnames="ceiling")
contrastive = jax.jit(contrastive_keypoint_loss)
dual_softmax = jax.jit(dual_softmax_loss)
hinge = jax.jit(hinge_descriptor_loss)
imitation = jax.jit(imitation_loss)


def test_heat_loss_is_the_binary_cross_entropy(rng):
    logits = rng.normal(size=(2, 2, 65)).astype(np.float32)
    labels = np.asarray(jax.nn.softmax(rng.normal(size=(2, 2, 65)).astype(np.float32)))
    p = np.asarray(jax.nn.softmax(logits), np.float64)
    entropy = -(labels * np.log(p) + (1 - labels) * np.log(1 - p)).sum(-1)
    weights = np.array([[1, 0], [1, 1]], np.float32)
    loss = jax.jit(heat_loss)(jnp.asarray(logits), jnp.asarray(labels), jnp.asarray(weights))
    np.testing.assert_allclose(loss, entropy[weights > 0].mean(), rtol=1e-5)


def test_heat_loss_is_least_at_the_labels(rng):
    target = jnp.asarray(rng.normal(size=(2, 2, 65)), jnp.float32)
    gradient = jax.jit(jax.grad(heat_loss))(target, jax.nn.softmax(target), jnp.ones((2, 2)))
    np.testing.assert_allclose(gradient, 0, atol=1e-5)


def test_a_certain_cell_puts_its_keypoint_there():
    logits = np.zeros((2, 3, 65), np.float32)
    logits[1, 2, 8 * 5 + 3] = 50.0
    positions = jax.jit(keypoint_positions)(logits)
    np.testing.assert_allclose(np.asarray(positions)[1, 2], [8 * 2 + 3, 8 * 1 + 5], atol=1e-4)


def test_contrastive_loss_draws_the_same_together_and_others_apart():
    here = jnp.asarray([[0.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    there = jnp.asarray([[8.0, 0.0], [4.0, 0.0], [80.0, 0.0]])
    same = jnp.asarray([True, False, False])
    each = [
        float(contrastive(here[i : i + 1], there[i : i + 1], same[i : i + 1], jnp.ones(1))) for i in range(3)
    ]
    assert each == pytest.approx([1.0, 0.25, 0.0], abs=1e-4)


def test_contrastive_loss_has_a_finite_gradient_at_distance_zero():
    zero = jnp.zeros((1, 2))
    gradient = jax.jit(jax.grad(contrastive_keypoint_loss))(zero, zero, jnp.asarray([False]), jnp.ones(1))
    assert np.all(np.isfinite(gradient))


def peaks(*pixels: tuple[int, int]) -> np.ndarray:
    """Logits of an image of 5 x 6 cells with sharp keypoints at the given (u, v)."""
    logits = np.zeros((5, 6, 65), np.float32)
    logits[..., -1] = 10.0
    for u, v in pixels:
        logits[v // 8, u // 8, 8 * (v % 8) + u % 8] = 20.0
    return logits


SEEN = np.zeros((40, 48), bool)
STILL = np.eye(3, dtype=np.float32)


def shifted(u: float, v: float) -> np.ndarray:
    homography = STILL.copy()
    homography[:2, 2] = u, v
    return homography


def test_reprojection_loss_is_the_mean_distance_in_pixels():
    a, b = peaks((12, 13), (25, 20)), peaks((15, 12), (28, 21))
    for move, expected in [((3.0, 0.0), 1.0), ((3.0, -1.0), (0 + 2) / 2), ((2.6, 0.0), np.hypot(0.4, 1))]:
        loss = reprojection(a, b, shifted(*move), SEEN, SEEN)
        assert float(loss) == pytest.approx(expected, abs=5e-3)


def test_reprojection_loss_counts_what_is_lost_as_its_ceiling_and_not_what_is_hidden_or_outside():
    a = peaks((12, 13), (25, 20))
    whole = reprojection(a, peaks((12, 13)), STILL, SEEN, SEEN, ceiling=2.0)
    assert float(whole) == pytest.approx((0 + 2) / 2, abs=5e-3)
    hidden = SEEN.copy()
    hidden[18:23, 23:28] = True
    for both in [(hidden, SEEN), (SEEN, hidden)]:
        loss = reprojection(a, peaks((12, 13)), STILL, *both)
        assert float(loss) == pytest.approx(0, abs=5e-3)
    assert float(reprojection(a, a, shifted(100.0, 0.0), SEEN, SEEN)) == 0


def test_reprojection_loss_draws_the_second_images_heat_towards_the_place(rng):
    a = peaks((20, 20))
    logits = peaks((20, 20))
    logits[2, 2] = 0.0
    logits[2, 2, 8 * 4 + 5] = 3.0  # the hottest is one pixel to the right
    slopes = jax.jit(jax.value_and_grad(reprojection_loss, argnums=(0, 1)))
    before, (_, gradient) = slopes(a, logits, STILL, SEEN, SEEN)
    assert np.all(np.isfinite(gradient))
    after, _ = slopes(a, logits - 0.5 * np.asarray(gradient), STILL, SEEN, SEEN)
    assert float(after) < float(before)
    _, (blank, _) = slopes(np.zeros_like(a), a, STILL, SEEN, SEEN)
    assert np.all(np.isfinite(blank))


def test_hinge_loss_has_the_papers_constants():
    a = jnp.asarray([[1.0, 0.0], [0.0, 1.0]])
    b = jnp.asarray([[0.8, 0.6], [0.6, 0.8]])
    places = jnp.asarray([[0.0, 0.0], [100.0, 0.0]])
    loss = hinge(a, b, places, places, jnp.asarray([True, True]))
    # Positives: 1 - 0.8 each. Negatives: 0.6 - 0.2 each.
    assert float(loss) == pytest.approx(1.3 * 0.2 + 0.4, abs=1e-6)
    near = jnp.asarray([[0.0, 0.0], [7.0, 0.0]])
    all_positive = hinge(a, b, near, near, jnp.asarray([True, True]))
    assert float(all_positive) == pytest.approx(1.3 * np.mean([0.2, 0.2, 0.4, 0.4]), abs=1e-6)


def test_dual_softmax_prefers_the_right_partner(rng):
    a = unit(jnp.asarray(rng.normal(size=(32, 16)), jnp.float32))
    right = dual_softmax(a, a, jnp.ones(32, bool))
    wrong = dual_softmax(a, jnp.roll(a, 1, axis=0), jnp.ones(32, bool))
    assert float(right) < 0.5 < 5 < float(wrong)


@pytest.mark.parametrize("loss", ["dual_softmax", "hinge"])
def test_unseen_points_change_no_descriptor_loss(loss, rng):
    a, b = (unit(jnp.asarray(rng.normal(size=(8, 4)), jnp.float32)) for _ in range(2))
    places = jnp.asarray(rng.uniform(0, 50, (8, 2)), jnp.float32)
    seen = jnp.asarray([True] * 6 + [False] * 2)

    def value(a):
        if loss == "hinge":
            return hinge(a, b, places, places, seen)
        return dual_softmax(a, b, seen)

    slope = jax.jit(jax.value_and_grad(value))
    turned = np.where(np.arange(8)[:, None] == 7, -a, a)
    expected, gradient = slope(a)
    np.testing.assert_allclose(slope(turned)[0], expected, rtol=1e-6)
    np.testing.assert_allclose(np.asarray(gradient)[6:], 0, atol=1e-7)


def test_imitation_and_reliability_are_least_at_the_labels(rng):
    labels = jnp.asarray(rng.normal(size=(3, 3, 8)), jnp.float32)
    assert float(imitation(2 * labels, labels, jnp.ones((3, 3)))) == pytest.approx(0, abs=1e-6)
    assert float(imitation(-labels, labels, jnp.ones((3, 3)))) == pytest.approx(2, abs=1e-6)
    wanted = jax.nn.sigmoid(labels[..., 0])
    gradient = jax.jit(jax.grad(reliability_loss))(labels[..., 0], wanted, jnp.ones((3, 3)))
    np.testing.assert_allclose(gradient, 0, atol=1e-7)
