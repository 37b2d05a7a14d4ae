"""Chordal relaxation: a start for large pose graphs from two linear problems, rotations and then origins.

Poses from odometry have rotations far off, which bend every step. But a rotation matrix enters R_a Z = R_b
linearly. Least squares over all 3 x 3 matrices, without the constraint that they are rotations, finds them
all at once. Each is then replaced by the nearest rotation. With rotations known, the origins are a linear
problem as well.

Source: Martinec and Pajdla, Robust rotation and translation estimation in multiview reconstruction (CVPR
2007); Carlone et al., Initialization techniques for 3D SLAM: a survey on rotation estimation and its use in
pose graph optimization (ICRA 2015), section III-B.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
from jax.lax import Precision
from jaxtyping import Array, Float

from sfgs_jax.arrays import checked
from sfgs_jax.factor_graph._values import Values
from sfgs_jax.factor_graph.factors._factor import Factor, squared_mahalanobis
from sfgs_jax.factor_graph.factors._pose_factors import PosePrior, RelativePose
from sfgs_jax.factor_graph.problem._graph import FactorGraph, check_values
from sfgs_jax.factor_graph.solver._cost import cost
from sfgs_jax.factor_graph.solver._linear_solvers import prepare_solve
from sfgs_jax.factor_graph.solver._normal_equations import add_pose_blocks, add_pose_rows, hold_fixed
from sfgs_jax.factor_graph.solver._schur_complement import ReducedSystem, damp_diagonal
from sfgs_jax.factor_graph.start._nearest_rotations import nearest_rotations
from sfgs_jax.geometry import se3

DAMPING = 1e-6
"""Share of the diagonal added, which keeps undetermined parts in place."""

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


@checked
def chordal_start(graph: FactorGraph, values: Values) -> Values:
    """Chordal relaxation: poses near the optimum of relative poses and priors.

    The given poses come back if they cost less. The relaxation uses only `RelativePose` and `PosePrior`,
    weighed by their mean information and by their kernels at the given values. Fixed poses and all landmarks
    stay.

    Args:
        graph: factors and structure.
        values: any start, for instance that of `spanning_tree_start`.

    Raises:
        InputError: numbers of poses or landmarks that don't match the graph's.
    """
    check_values(graph, values)
    return _chordal_start(graph, values)


@jax.jit
def _chordal_start(graph: FactorGraph, values: Values) -> Values:
    given = se3.rotation_matrix(values.poses)
    weights = [_weights(factor, values) for factor in graph.factors]
    free = jnp.asarray(graph.free_poses)
    # Free matrices start at 0, not at the given rotations. Noise makes matrices far from the fixed poses
    # smaller by orders of magnitude, and a difference to a rotation would lose them to rounding.
    fixed = jnp.where(free[:, None, None], 0, given)
    rows = [_rotation_rows(f, fixed, w) for f, w in zip(graph.factors, weights, strict=True)]
    relaxed = jnp.swapaxes(_least_squares(graph, rows, 3), 1, 2)
    rotations, proper = nearest_rotations(relaxed)
    moves = proper & free
    rotations = jnp.where(moves[:, None, None], rotations, given)

    # The second factorisation waits for the first, although its matrix is known: two batched LAPACK calls at
    # once can end in a deadlock (see `multifrontal_solve`).
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
    """Weights of the rows' translations and rotations; None for factors of other kinds."""
    if not isinstance(factor, (RelativePose, PosePrior)):
        return None
    residual, information = factor.residuals(values)
    assert information is not None
    robust = factor.robust_weight(squared_mahalanobis(residual, information))
    diagonal = jnp.diagonal(information).T
    return robust * jnp.mean(diagonal[:3], axis=0), robust * jnp.mean(diagonal[3:], axis=0)


def _rotation_rows(
    factor: Factor, rotations: Float[Array, "P 3 3"], weights: tuple[Array, Array] | None
) -> _Rows | None:
    """R_a Z = R_b, or R = Z for a prior, transposed: three equations for each of the three columns."""
    if weights is None:
        return None
    Z, here = _measured(factor), _gather(factor, rotations)
    minus = jnp.broadcast_to(-jnp.eye(3, dtype=Z.dtype), Z[:, :3, :3].shape)
    across = jnp.swapaxes(Z[:, :3, :3], 1, 2)
    if isinstance(factor, PosePrior):
        jacobian, residual = minus[:, :, None], across - jnp.swapaxes(here[:, 0], 1, 2)
    else:
        jacobian = jnp.stack([across, minus], axis=2)
        turned = jnp.matmul(here[:, 0], Z[:, :3, :3], precision=Precision.HIGHEST)
        residual = jnp.swapaxes(turned - here[:, 1], 1, 2)
    return _Rows(jacobian, residual, weights[1])


def _origin_rows(
    factor: Factor,
    rotations: Float[Array, "P 3 3"],
    origins: Float[Array, "P 3"],
    weights: tuple[Array, Array] | None,
) -> _Rows | None:
    """t_a + R_a z = t_b, or t = z for a prior: one equation for each of the three coordinates."""
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
    """Measured motions of pose factors, as matrices."""
    return se3.matrix(factor.clean_measurements()[0])


def _gather(factor: Factor, parts: Float[Array, "P ..."]) -> Float[Array, "N k ..."]:
    """Parts of the poses that each row touches."""
    return parts[jnp.where(jnp.asarray(factor.valid)[:, None], jnp.asarray(factor.poses), 0)]


def _least_squares(graph: FactorGraph, rows: list[_Rows | None], d: int) -> Float[Array, "P d 3"]:
    """Weighted least squares: changes of the free poses, 0 for poses without an equation."""
    dtype = jnp.result_type(*(r.weight for r in rows if r is not None), jnp.zeros(0))
    P, B = graph.num_poses, len(graph.structure.rows)
    blocks, gradient = jnp.zeros((P + B + 1, d, d), dtype), jnp.zeros((P, d, 3), dtype)
    for i, r in enumerate(rows):
        if r is not None:
            weighted = r.jacobian * r.weight[:, None, None, None]
            hessian = jnp.einsum("neax,neby->naxby", weighted, r.jacobian, precision=Precision.HIGHEST)
            pull = jnp.einsum("neax,nem->naxm", weighted, r.residual, precision=Precision.HIGHEST)
            blocks = add_pose_blocks(graph, i, hessian, blocks)
            gradient = add_pose_rows(graph, i, pull, gradient)
    diagonal, off_diagonal, known = hold_fixed(graph, blocks)
    right = jnp.where(known[:, None, None], -gradient, 0)
    damped = damp_diagonal(diagonal, jnp.asarray(DAMPING, dtype))
    system = ReducedSystem(damped, off_diagonal, right[:, :, 0])
    solve = prepare_solve(graph, system, pcg_tolerance=PCG_TOLERANCE, pcg_max_iterations=PCG_ITERATIONS)
    return jax.vmap(solve, in_axes=2, out_axes=2)(right)
