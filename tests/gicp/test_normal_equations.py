"""Normal equations against automatic differentiation, and residual weights against their definition."""

import jax
import jax.numpy as jnp
import numpy as np

from sfgs_jax.arrays import SQUARE
from sfgs_jax.geometry import se3
from sfgs_jax.gicp import (
    Correspondences,
    GicpConfig,
    PointsConfig,
    level_problem,
    prepare_points,
    weight_matrices,
)
from tests.gicp.test_point_clouds import room

# One program instead of one for each operation.
weights_of = jax.jit(weight_matrices, static_argnames=("residual", "epsilon"))


def unit_columns(rng, n: int) -> np.ndarray:
    vectors = rng.normal(size=(3, n))
    return vectors / np.linalg.norm(vectors, axis=0)


def full(weights) -> np.ndarray:
    """(N, 3, 3) matrices of (6, N) upper triangles."""
    return np.asarray(weights)[SQUARE].transpose(2, 0, 1)


def test_hessian_and_gradient_are_those_of_the_perturbed_residual(float64, rng):
    cloud = prepare_points(jnp.asarray(room(rng, 500)), config=PointsConfig(levels=1, max_points=128))
    config = GicpConfig(kernel="none", epsilon=0.01)
    problem = jax.jit(lambda levels: level_problem(levels, levels, None, 0, config))(cloud.levels)
    p, s = problem.source.points, problem.source.normals
    n = p.shape[1]
    q, t = jnp.asarray(rng.normal(size=(3, n))), jnp.asarray(unit_columns(rng, n))
    variance, valid = jnp.asarray(rng.uniform(0.5, 2, n)), problem.source.valid
    pairs = Correspondences(q, t, None, variance, valid, valid, valid)

    def residuals(delta):
        r = se3.transform(se3.exp(delta), p.T) - q.T
        return r, r

    jacobian, r = map(np.asarray, jax.jit(jax.jacfwd(residuals, has_aux=True))(jnp.zeros(6)))
    weights = np.where(valid, 1 / variance, 0)
    w = full(weights_of(s, t, residual="gicp", epsilon=0.01)) * weights[:, None, None]
    found = jax.jit(lambda problem, *at: problem.equations(*at))(problem, se3.identity(jnp.float64), pairs)
    np.testing.assert_allclose(
        found.hessian, np.einsum("nai,nab,nbj->ij", jacobian, w, jacobian), rtol=1e-10, atol=1e-9
    )
    np.testing.assert_allclose(
        found.gradient, np.einsum("nai,nab,nb->i", jacobian, w, r), rtol=1e-10, atol=1e-9
    )
    np.testing.assert_allclose(found.weight, np.sum(weights), rtol=1e-10)


def test_gicp_weights_are_the_inverse_of_the_summed_covariances(float64, rng):
    s, t = unit_columns(rng, 50), unit_columns(rng, 50)
    t[:, 0] = s[:, 0]  # parallel normals, where one eigenvector vanishes
    epsilon = 1e-3
    weights = weights_of(jnp.asarray(s), jnp.asarray(t), residual="gicp", epsilon=epsilon)
    covariances = [np.eye(3) - (1 - epsilon) * np.einsum("an,bn->nab", n, n) for n in (s, t)]
    expected = 2 * epsilon * np.linalg.inv(covariances[0] + covariances[1])
    np.testing.assert_allclose(full(weights), expected, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(s[:, 0] @ full(weights)[0] @ s[:, 0], 1, rtol=1e-8)


def test_point_to_plane_sees_only_the_target_normal_and_point_to_point_everything(rng):
    s, t = (jnp.asarray(unit_columns(rng, 5), jnp.float32) for _ in range(2))
    plane = full(weights_of(s, t, residual="point_to_plane", epsilon=0.01))
    np.testing.assert_allclose(plane, np.einsum("an,bn->nab", t, t), rtol=1e-6)
    point = full(weights_of(s, t, residual="point_to_point", epsilon=0.01))
    np.testing.assert_array_equal(point, np.broadcast_to(np.eye(3), (5, 3, 3)))
