"""Small matrices in lanes, and closed forms for symmetric ones, against NumPy and finite differences."""

import jax
import jax.numpy as jnp
import numpy as np

from sfgs_jax import arrays

# One program for each instead of one for each operation.
apply = jax.jit(arrays.apply)
apply_transposed = jax.jit(arrays.apply_transposed)
back_substitution = jax.jit(arrays.back_substitution)
cholesky = jax.jit(arrays.cholesky)
dot = jax.jit(arrays.dot)
forward_substitution = jax.jit(arrays.forward_substitution)
from_upper_triangles = jax.jit(arrays.from_upper_triangles)
gauss_jordan = jax.jit(arrays.gauss_jordan)
identity_like = jax.jit(arrays.identity_like)
multiply = jax.jit(arrays.multiply)
multiply_transposed = jax.jit(arrays.multiply_transposed)
outer = jax.jit(arrays.outer)
side_by_side = jax.jit(arrays.side_by_side)
smallest_eigenpair = jax.jit(arrays.smallest_eigenpair)
symmetric_inverse = jax.jit(arrays.symmetric_inverse)
symmetric_product = jax.jit(arrays.symmetric_product)
upper_triangles = jax.jit(arrays.upper_triangles)


def triangles(matrices: np.ndarray, dtype: type = np.float32) -> jax.Array:
    return upper_triangles(jnp.asarray(matrices, dtype))


def with_spectrum(rng, values) -> np.ndarray:
    """200 matrices with given eigenvalues in random directions."""
    q = np.linalg.qr(rng.normal(size=(200, 3, 3)))[0]
    return np.einsum("nij,j,nkj->nik", q, values, q)


def lanes(matrices: np.ndarray) -> jax.Array:
    """(N, ...) as (..., N)."""
    return jnp.asarray(np.moveaxis(matrices, 0, -1))


def test_products_are_those_of_the_matrices(rng):
    a, b = rng.normal(size=(2, 50, 3, 4)).astype(np.float32)
    c, v, w = (rng.normal(size=(50, *shape)).astype(np.float32) for shape in ((4, 2), (4,), (3,)))
    cases = [
        (multiply(lanes(a), lanes(c)), a @ c),
        (multiply_transposed(lanes(a), lanes(b)), np.swapaxes(a, 1, 2) @ b),
        (apply(lanes(a), lanes(v)), np.einsum("nij,nj->ni", a, v)),
        (apply_transposed(lanes(a), lanes(w)), np.einsum("nij,ni->nj", a, w)),
        (dot(lanes(w), lanes(w)), np.sum(w * w, axis=1)),
    ]
    for found, expected in cases:
        np.testing.assert_allclose(np.moveaxis(np.asarray(found), -1, 0), expected, rtol=1e-5, atol=1e-6)


def test_triangles_are_those_of_the_matrices(rng):
    matrices = with_spectrum(rng, [0.1, 1.0, 2.0]).astype(np.float32)
    entries = upper_triangles(jnp.asarray(matrices))
    np.testing.assert_array_equal(entries[3], matrices[:, 1, 1])
    np.testing.assert_allclose(from_upper_triangles(entries), matrices, atol=1e-6)
    vectors = jnp.asarray(rng.normal(size=(3, 200)), jnp.float32)
    expected = np.einsum("nij,jn->in", matrices, vectors)
    np.testing.assert_allclose(symmetric_product(entries, vectors), expected, atol=1e-5)
    np.testing.assert_allclose(
        from_upper_triangles(outer(vectors)), np.einsum("in,jn->nij", vectors, vectors), rtol=1e-6
    )
    identities = from_upper_triangles(identity_like(entries[0]))
    np.testing.assert_array_equal(identities, np.tile(np.eye(3, dtype=np.float32), (200, 1, 1)))


def test_cholesky_factors_solve(rng):
    matrices = with_spectrum(rng, [0.1, 1.0, 2.0]).astype(np.float32)
    factor, deficient = cholesky(jnp.asarray(matrices))
    assert not np.any(deficient)
    np.testing.assert_allclose(factor, np.linalg.cholesky(matrices), atol=1e-5)
    right = rng.normal(size=(200, 3, 2)).astype(np.float32)
    half = forward_substitution(factor, jnp.moveaxis(jnp.asarray(right), 1, 0))
    expected = np.linalg.solve(np.linalg.cholesky(matrices), right)
    np.testing.assert_allclose(np.moveaxis(np.asarray(half), 0, 1), expected, atol=1e-4)
    whole = back_substitution(factor, jnp.moveaxis(half, 0, 1)[..., 0])
    np.testing.assert_allclose(whole, np.linalg.solve(matrices, right)[..., 0], atol=1e-3)


def test_cholesky_names_the_deficient_and_stays_finite():
    matrices = np.stack([np.eye(3), np.diag([1.0, 1.0, 0.0]), np.ones((3, 3)), np.diag([1.0, -1.0, 1.0])])
    factor, deficient = cholesky(jnp.asarray(matrices, jnp.float32))
    np.testing.assert_array_equal(deficient, [False, True, True, True])
    assert np.all(np.isfinite(factor))


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


def test_elimination_solves_positive_definite_equations(rng):
    for size in (1, 3, 6):
        root, right = rng.normal(size=(size, size + 2)), rng.normal(size=(size, 2))
        matrix = root @ root.T / size
        pivots, found = gauss_jordan(jnp.asarray(np.concatenate([matrix, right], axis=1), jnp.float32))
        expected = np.linalg.solve(matrix, right)
        np.testing.assert_allclose(found, expected, rtol=2e-4, atol=2e-4 * np.abs(expected).max())
        np.testing.assert_allclose(np.prod(pivots), np.linalg.det(matrix), rtol=1e-4)


def test_pivots_tell_whether_a_symmetric_matrix_is_positive_definite(rng):
    for least in (-1.0, -0.01, 0.01, 1.0):
        for _ in range(10):
            q = np.linalg.qr(rng.normal(size=(6, 6)))[0]
            matrix = q @ np.diag([least, *rng.uniform(0.1, 2, 5)]) @ q.T
            pivots, rest = gauss_jordan(jnp.asarray(matrix, jnp.float32))
            assert bool(jnp.all(pivots > 0)) == (least > 0)
            assert rest.shape == (6, 0)


def test_elimination_of_a_singular_matrix_makes_no_nan():
    pivots, found = gauss_jordan(jnp.zeros((6, 7)))
    assert not jnp.any(pivots > 0)
    assert jnp.all(jnp.isfinite(found))


def test_columns_side_by_side_are_those_given(rng):
    columns = rng.normal(size=(5, 4, 7)).astype(np.float32)
    for count in (1, 2, 5):
        found = side_by_side([jnp.asarray(column) for column in columns[:count]])
        np.testing.assert_array_equal(found, np.moveaxis(columns[:count], 0, -1))
