"""The normal equations against automatic differentiation, and the weights against their definition."""

import jax
import jax.numpy as jnp
import numpy as np

from sfgs_jax.geometry import se3
from sfgs_jax.gicp.normal_equations import gradient, hessian, moment_sums, point_moments, pulls
from sfgs_jax.gicp.residuals import weight_matrices
from sfgs_jax.gicp.symmetric import SQUARE


def unit_columns(rng, n: int) -> np.ndarray:
    vectors = rng.normal(size=(3, n))
    return vectors / np.linalg.norm(vectors, axis=0)


def full(weights) -> np.ndarray:
    """(N, 3, 3) matrices of (6, N) upper triangles."""
    return np.asarray(weights)[SQUARE].transpose(2, 0, 1)


def test_hessian_and_gradient_are_those_of_the_perturbed_residual(float64, rng):
    p, q = (jnp.asarray(rng.normal(size=(3, 20))) for _ in range(2))
    s, t = (jnp.asarray(unit_columns(rng, 20)) for _ in range(2))
    weights = weight_matrices(s, t, residual="gicp", epsilon=0.01)

    def residuals(delta):
        return se3.transform(se3.exp(delta), p.T) - q.T

    jacobian = np.asarray(jax.jacfwd(residuals)(jnp.zeros(6)))
    sums, pulled = moment_sums(point_moments(p), weights, pulls(weights, p - q))
    w, r = full(weights), np.asarray(residuals(jnp.zeros(6)))
    np.testing.assert_allclose(
        hessian(sums), np.einsum("nai,nab,nbj->ij", jacobian, w, jacobian), rtol=1e-10, atol=1e-9
    )
    np.testing.assert_allclose(
        gradient(pulled), np.einsum("nai,nab,nb->i", jacobian, w, r), rtol=1e-10, atol=1e-9
    )


def test_gicp_weights_are_the_inverse_of_the_summed_covariances(float64, rng):
    s, t = unit_columns(rng, 50), unit_columns(rng, 50)
    t[:, 0] = s[:, 0]  # parallel normals, where one eigenvector vanishes
    epsilon = 1e-3
    weights = weight_matrices(jnp.asarray(s), jnp.asarray(t), residual="gicp", epsilon=epsilon)
    covariances = [np.eye(3) - (1 - epsilon) * np.einsum("an,bn->nab", n, n) for n in (s, t)]
    expected = 2 * epsilon * np.linalg.inv(covariances[0] + covariances[1])
    np.testing.assert_allclose(full(weights), expected, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(s[:, 0] @ full(weights)[0] @ s[:, 0], 1, rtol=1e-8)


def test_point_to_plane_sees_only_the_target_normal_and_point_to_point_everything(rng):
    s, t = (jnp.asarray(unit_columns(rng, 5), jnp.float32) for _ in range(2))
    plane = full(weight_matrices(s, t, residual="point_to_plane", epsilon=0.01))
    np.testing.assert_allclose(plane, np.einsum("an,bn->nab", t, t), rtol=1e-6)
    point = full(weight_matrices(s, t, residual="point_to_point", epsilon=0.01))
    np.testing.assert_array_equal(point, np.broadcast_to(np.eye(3), (5, 3, 3)))
