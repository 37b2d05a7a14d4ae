"""Closed forms for symmetric 3 x 3 matrices against NumPy and finite differences."""

import jax
import jax.numpy as jnp
import numpy as np

from sfgs_jax.gicp.symmetric import INDICES, smallest_eigenpair, symmetric_inverse


def triangles(matrices: np.ndarray, dtype=np.float32) -> jax.Array:
    return jnp.asarray(np.stack([matrices[:, i, j] for i, j in INDICES]), dtype)


def with_spectrum(rng, values) -> np.ndarray:
    """200 matrices with given eigenvalues in random directions."""
    q = np.linalg.qr(rng.normal(size=(200, 3, 3)))[0]
    return np.einsum("nij,j,nkj->nik", q, values, q)


def test_the_pair_is_that_of_eigh_at_any_scale(rng):
    for values in ([0.001, 1.0, 1.0], [0.1, 0.5, 2.0], [0.0, 0.3, 1.0], [1e-4, 0.01, 1.0]):
        for scale in (1e-6, 1.0, 1e4):
            matrices = with_spectrum(rng, np.asarray(values) * scale)
            value, vector = smallest_eigenpair(triangles(matrices))
            expected_values, expected_vectors = np.linalg.eigh(matrices)
            np.testing.assert_allclose(value, expected_values[:, 0], atol=3e-6 * scale * values[2])
            cosine = np.abs(np.sum(np.asarray(vector).T * expected_vectors[:, :, 0], axis=1))
            gap = (values[1] - values[0]) / values[2]
            np.testing.assert_array_less(1 - (1e-6 / gap) ** 2 - 1e-6, cosine)


def test_repeated_eigenvalues_give_a_unit_vector_of_their_space(rng):
    line = with_spectrum(rng, [0.0, 0.0, 1.0])
    value, vector = smallest_eigenpair(triangles(line))
    np.testing.assert_allclose(np.linalg.norm(vector, axis=0), 1, rtol=1e-5)
    np.testing.assert_allclose(np.einsum("nij,jn->ni", line, np.asarray(vector)), 0, atol=3e-3)
    np.testing.assert_allclose(value, 0, atol=1e-5)
    for matrices in (np.zeros((1, 3, 3)), 5 * np.eye(3)[None]):
        value, vector = smallest_eigenpair(triangles(matrices))
        np.testing.assert_allclose(value, matrices[0, 0, 0], rtol=1e-6)
        np.testing.assert_array_equal(vector[:, 0], [0, 0, 1])


def test_derivatives_are_those_of_finite_differences(float64, rng):
    matrices = triangles(with_spectrum(rng, [0.01, 0.4, 1.0]), np.float64)
    change = jnp.asarray(rng.normal(size=matrices.shape))
    _, (value_rate, vector_rate) = jax.jvp(smallest_eigenpair, (matrices,), (change,))
    h = 1e-6
    (value_up, up), (value_down, down) = (smallest_eigenpair(matrices + s * h * change) for s in (1, -1))
    np.testing.assert_allclose(value_rate, (value_up - value_down) / (2 * h), atol=1e-6)
    np.testing.assert_allclose(vector_rate, (up - down) / (2 * h), atol=1e-6)


def test_gradients_are_finite_where_eigenvalues_repeat():
    def total(matrices):
        value, vector = smallest_eigenpair(matrices)
        return jnp.sum(value) + jnp.sum(vector)

    degenerate = np.stack([np.zeros((3, 3)), np.eye(3), np.diag([0.0, 0.0, 1.0])])
    assert np.all(np.isfinite(jax.grad(total)(triangles(degenerate))))


def test_inverses_and_the_singular(rng):
    matrices = with_spectrum(rng, [0.01, 1.0, 2.0])
    inverse, regular = symmetric_inverse(triangles(matrices))
    assert np.all(regular)
    np.testing.assert_allclose(inverse, triangles(np.linalg.inv(matrices)), rtol=1e-3, atol=1e-2)
    inverse, regular = symmetric_inverse(triangles(np.diag([1.0, 1.0, 0.0])[None]))
    assert not regular[0]
    assert not np.any(inverse)
