import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.superfeats.losses import (
    contrastive_keypoint_loss,
    dual_softmax_loss,
    heat_loss,
    hinge_descriptor_loss,
    imitation_loss,
    keypoint_positions,
    reliability_loss,
    unit,
)


def test_heat_loss_is_the_binary_cross_entropy(rng):
    logits = rng.normal(size=(2, 2, 65)).astype(np.float32)
    labels = np.asarray(jax.nn.softmax(rng.normal(size=(2, 2, 65)).astype(np.float32)))
    p = np.asarray(jax.nn.softmax(logits), np.float64)
    entropy = -(labels * np.log(p) + (1 - labels) * np.log(1 - p)).sum(-1)
    weights = np.array([[1, 0], [1, 1]], np.float32)
    loss = heat_loss(jnp.asarray(logits), jnp.asarray(labels), jnp.asarray(weights))
    np.testing.assert_allclose(loss, entropy[weights > 0].mean(), rtol=1e-5)


def test_heat_loss_is_least_at_the_labels(rng):
    target = jnp.asarray(rng.normal(size=(2, 2, 65)), jnp.float32)
    gradient = jax.grad(heat_loss)(target, jax.nn.softmax(target), jnp.ones((2, 2)))
    np.testing.assert_allclose(gradient, 0, atol=1e-5)


def test_a_certain_cell_puts_its_keypoint_there():
    logits = jnp.zeros((2, 3, 65)).at[1, 2, 8 * 5 + 3].set(50.0)
    np.testing.assert_allclose(keypoint_positions(logits)[1, 2], [8 * 2 + 3, 8 * 1 + 5], atol=1e-4)


def test_contrastive_loss_draws_the_same_together_and_others_apart():
    here = jnp.asarray([[0.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    there = jnp.asarray([[8.0, 0.0], [4.0, 0.0], [80.0, 0.0]])
    same = jnp.asarray([True, False, False])
    each = [
        float(contrastive_keypoint_loss(here[i : i + 1], there[i : i + 1], same[i : i + 1], jnp.ones(1)))
        for i in range(3)
    ]
    assert each == pytest.approx([1.0, 0.25, 0.0], abs=1e-4)


def test_contrastive_loss_has_a_finite_gradient_at_distance_zero():
    zero = jnp.zeros((1, 2))
    gradient = jax.grad(contrastive_keypoint_loss)(zero, zero, jnp.asarray([False]), jnp.ones(1))
    assert bool(jnp.isfinite(gradient).all())


def test_hinge_loss_has_the_papers_constants():
    a = jnp.asarray([[1.0, 0.0], [0.0, 1.0]])
    b = jnp.asarray([[0.8, 0.6], [0.6, 0.8]])
    places = jnp.asarray([[0.0, 0.0], [100.0, 0.0]])
    loss = hinge_descriptor_loss(a, b, places, places, jnp.asarray([True, True]))
    # Positives: 1 - 0.8 each. Negatives: 0.6 - 0.2 each.
    assert float(loss) == pytest.approx(1.3 * 0.2 + 0.4, abs=1e-6)
    near = jnp.asarray([[0.0, 0.0], [7.0, 0.0]])
    all_positive = hinge_descriptor_loss(a, b, near, near, jnp.asarray([True, True]))
    assert float(all_positive) == pytest.approx(1.3 * np.mean([0.2, 0.2, 0.4, 0.4]), abs=1e-6)


def test_dual_softmax_prefers_the_right_partner(rng):
    a = unit(jnp.asarray(rng.normal(size=(32, 16)), jnp.float32))
    right = dual_softmax_loss(a, a, jnp.ones(32, bool))
    wrong = dual_softmax_loss(a, jnp.roll(a, 1, axis=0), jnp.ones(32, bool))
    assert float(right) < 0.5 < 5 < float(wrong)


@pytest.mark.parametrize("loss", ["dual_softmax", "hinge"])
def test_unseen_points_change_no_descriptor_loss(loss, rng):
    a, b = (unit(jnp.asarray(rng.normal(size=(8, 4)), jnp.float32)) for _ in range(2))
    places = jnp.asarray(rng.uniform(0, 50, (8, 2)), jnp.float32)
    seen = jnp.asarray([True] * 6 + [False] * 2)

    def value(a):
        if loss == "hinge":
            return hinge_descriptor_loss(a, b, places, places, seen)
        return dual_softmax_loss(a, b, seen)

    np.testing.assert_allclose(value(a), value(a.at[7].set(-a[7])), rtol=1e-6)
    np.testing.assert_allclose(jax.grad(value)(a)[6:], 0, atol=1e-7)


def test_imitation_and_reliability_are_least_at_the_labels(rng):
    labels = jnp.asarray(rng.normal(size=(3, 3, 8)), jnp.float32)
    assert float(imitation_loss(2 * labels, labels, jnp.ones((3, 3)))) == pytest.approx(0, abs=1e-6)
    assert float(imitation_loss(-labels, labels, jnp.ones((3, 3)))) == pytest.approx(2, abs=1e-6)
    wanted = jax.nn.sigmoid(labels[..., 0])
    gradient = jax.grad(reliability_loss)(labels[..., 0], wanted, jnp.ones((3, 3)))
    np.testing.assert_allclose(gradient, 0, atol=1e-7)
