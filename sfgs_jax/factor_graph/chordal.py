"""A start for large pose graphs: rotations from one linear problem, then origins from another.

A step from poses that odometry led to goes wrong because rotations far off bend it. But a rotation's matrix
enters R_a Z = R_b linearly. Found by least squares without asking whether it is a rotation, and brought to
the nearest one afterwards, all matrices come out near the optimum at once, and with rotations known the
origins are a linear problem as well.

Source: Martinec and Pajdla, Robust rotation and translation estimation in multiview reconstruction (CVPR
2007); Carlone et al., Initialization techniques for 3D SLAM: a survey on rotation estimation and its use in
pose graph optimization (ICRA 2015), section III-B.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Bool, Float

from sfgs_jax.factor_graph.factor import Factor, squared
from sfgs_jax.factor_graph.graph import FactorGraph
from sfgs_jax.factor_graph.linear_solvers import prepare_solve
from sfgs_jax.factor_graph.normal_equations import (
    Reduced,
    add_pose_blocks,
    add_pose_rows,
    damp,
    hold_fixed,
)
from sfgs_jax.factor_graph.optimise import check_sizes, cost
from sfgs_jax.factor_graph.pose_factors import PosePrior, RelativePose
from sfgs_jax.factor_graph.values import Values
from sfgs_jax.geometry import se3

DAMPING = 1e-6
"""Keeps parts that nothing holds in place where they are."""

POLAR_STEPS = 12
"""Newton steps to the nearest rotation: enough for singular values 1000 apart."""

PCG_TOLERANCE, PCG_ITERATIONS = 1e-5, 1000


class _Rows(eqx.Module):
    """Linear equations of M groups of poses: jacobian x + residual = 0, for m columns x of each pose.

    Attributes:
        jacobian: (M, d, k, d).
        residual: (M, d, m).
        weight: (M,).
    """

    jacobian: Float[Array, "M d k d"]
    residual: Float[Array, "M d m"]
    weight: Float[Array, " M"]


def chordal_start(graph: FactorGraph, values: Values) -> Values:
    """Poses near the optimum of relative poses and priors, from any start; the given ones if these cost less.

    Only `RelativePose` and `PosePrior` are looked at, weighed by their mean information and by their kernels
    at the given values. Fixed poses and all landmarks stay.

    Args:
        graph: factors and structure.
        values: where to start, as `odometry_start`.

    Raises:
        InputError: numbers of poses or landmarks that don't match the graph's.
    """
    check_sizes(graph, values)
    return _chordal_start(graph, values)


@jax.jit
def _chordal_start(graph: FactorGraph, values: Values) -> Values:
    given = se3.rotation_matrix(values.poses)
    weights = [_weights(factor, values) for factor in graph.factors]
    free = jnp.asarray(graph.free_poses)
    # Solved for from 0, not from what is given: noise makes the matrices shrink by orders of magnitude on the
    # way from the fixed poses, and small ones would drown in the rounding of a difference.
    fixed = jnp.where(free[:, None, None], 0, given)
    rows = [_rotation_rows(f, fixed, w) for f, w in zip(graph.factors, weights, strict=True)]
    relaxed = jnp.swapaxes(_least_squares(graph, rows, 3), 1, 2)
    rotations, proper = _nearest_rotations(relaxed)
    moves = proper & free
    rotations = jnp.where(moves[:, None, None], rotations, given)

    # Not before the rotations are found, although the matrix is known: XLA would factorise both at once, and
    # two batched LAPACK calls can end in a deadlock (see `multifrontal_solve`).
    whole = jnp.all(jnp.isfinite(relaxed))
    weights = jax.tree.map(lambda weight: jnp.where(whole, weight, jnp.nan), weights)
    origins = values.poses.wxyz_xyz[:, 4:]
    rows = [_origin_rows(f, rotations, origins, w) for f, w in zip(graph.factors, weights, strict=True)]
    origins += _least_squares(graph, rows, 1)[:, 0]
    wxyz = jnp.where(moves[:, None], se3.quaternions(rotations), values.poses.wxyz_xyz[:, :4])
    found = Values(jaxlie.SE3(jnp.concatenate([wxyz, origins], axis=1)), values.landmarks)
    lower = cost(graph, found) < cost(graph, values)
    return jax.tree.map(lambda x, y: jnp.where(lower, x, y), found, values)


def _weights(factor: Factor, values: Values) -> tuple[Array, Array] | None:
    """Weights of the rows' translations and rotations; None of factors that are not of poses alone."""
    if not isinstance(factor, (RelativePose, PosePrior)):
        return None
    residual, information = factor.residuals(values)
    assert information is not None
    robust = factor.robust_weight(squared(residual, information))
    diagonal = jnp.diagonal(information).T
    return robust * jnp.mean(diagonal[:3], axis=0), robust * jnp.mean(diagonal[3:], axis=0)


def _rotation_rows(
    factor: Factor, rotations: Float[Array, "P 3 3"], weights: tuple[Array, Array] | None
) -> _Rows | None:
    """R_a Z = R_b, or R = Z: the same three equations for each row of the matrices, hence transposed."""
    if weights is None:
        return None
    Z, here = _measured(factor), _gather(factor, rotations)
    minus = jnp.broadcast_to(-jnp.eye(3, dtype=Z.dtype), Z[:, :3, :3].shape)
    across = jnp.swapaxes(Z[:, :3, :3], 1, 2)
    if isinstance(factor, PosePrior):
        jacobian, residual = minus[:, :, None], across - jnp.swapaxes(here[:, 0], 1, 2)
    else:
        jacobian = jnp.stack([across, minus], axis=2)
        residual = jnp.swapaxes(here[:, 0] @ Z[:, :3, :3] - here[:, 1], 1, 2)
    return _Rows(jacobian, residual, weights[1])


def _origin_rows(
    factor: Factor,
    rotations: Float[Array, "P 3 3"],
    origins: Float[Array, "P 3"],
    weights: tuple[Array, Array] | None,
) -> _Rows | None:
    """t_a + R_a z = t_b, or t = z: one equation for each coordinate."""
    if weights is None:
        return None
    z, here = _measured(factor)[:, :3, 3], _gather(factor, origins)
    one = jnp.ones((len(z), 1, 1, 1), z.dtype)
    if isinstance(factor, PosePrior):
        return _Rows(-one, (z - here[:, 0])[:, None], weights[0])
    step = jnp.sum(_gather(factor, rotations)[:, 0] * z[:, None], axis=2)
    residual = here[:, 0] + step - here[:, 1]
    return _Rows(jnp.concatenate([one, -one], axis=2), residual[:, None], weights[0])


def _measured(factor: Factor) -> Float[Array, "N 4 4"]:
    return se3.matrix(factor.clean_measurements()[0])


def _gather(factor: Factor, parts: Float[Array, "P ..."]) -> Float[Array, "N k ..."]:
    """Parts of the poses that each row touches."""
    return parts[jnp.where(jnp.asarray(factor.valid)[:, None], jnp.asarray(factor.poses), 0)]


def _least_squares(graph: FactorGraph, rows: list[_Rows | None], d: int) -> Float[Array, "P d 3"]:
    """Changes of the free poses that fulfil the equations best; 0 where no equation says anything."""
    dtype = jnp.result_type(*(r.weight for r in rows if r is not None), jnp.zeros(0))
    P, B = graph.num_poses, len(graph.structure.rows)
    blocks, gradient = jnp.zeros((P + B + 1, d, d), dtype), jnp.zeros((P, d, 3), dtype)
    for i, r in enumerate(rows):
        if r is not None:
            weighted = r.jacobian * r.weight[:, None, None, None]
            blocks = add_pose_blocks(graph, i, jnp.einsum("neax,neby->naxby", weighted, r.jacobian), blocks)
            gradient = add_pose_rows(graph, i, jnp.einsum("neax,nem->naxm", weighted, r.residual), gradient)
    diagonal, off_diagonal, known = hold_fixed(graph, blocks)
    right = jnp.where(known[:, None, None], -gradient, 0)
    system = Reduced(damp(diagonal, jnp.asarray(DAMPING, dtype)), off_diagonal, right[:, :, 0])
    solve = prepare_solve(graph, system, pcg_tolerance=PCG_TOLERANCE, pcg_max_iterations=PCG_ITERATIONS)
    return jax.vmap(solve, in_axes=2, out_axes=2)(right)


def _nearest_rotations(matrices: Float[Array, "P 3 3"]) -> tuple[Float[Array, "P 3 3"], Bool[Array, " P"]]:
    """Rotations nearest to matrices, and which matrices have one: those with a positive determinant.

    The orthogonal factor of the polar decomposition, by Newton's iteration X <- (X + X^-T) / 2 (Higham,
    Computing the polar decomposition, with applications, 1986, eq. 3.3), from matrices of determinant 1.
    """
    X = jnp.moveaxis(matrices, 0, -1)  # lanes last, for SIMD
    largest = jnp.max(jnp.abs(X), axis=(0, 1))
    # The determinant of a small matrix may be less than float32 knows.
    X /= jnp.where(largest > 0, largest, 1)
    volume = jnp.sum(X[0] * _cofactors(X)[0], axis=0)
    proper = volume > 0
    X = jnp.where(proper, X / jnp.cbrt(jnp.where(proper, volume, 1)), jnp.eye(3, dtype=X.dtype)[:, :, None])
    for _ in range(POLAR_STEPS):
        cofactors = _cofactors(X)
        X = (X + cofactors / jnp.sum(X[0] * cofactors[0], axis=0)) / 2
    return jnp.moveaxis(X, -1, 0), proper


def _cofactors(X: Float[Array, "3 3 P"]) -> Float[Array, "3 3 P"]:
    """Determinant times inverse transpose."""
    return jnp.stack([jnp.cross(X[i - 2], X[i - 1], axis=0) for i in range(3)])
