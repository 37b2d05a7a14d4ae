"""Marginal covariances of chosen variables: blocks of the inverse Hessian."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from sfgs_jax.arrays import InputError, checked
from sfgs_jax.factor_graph._values import Values
from sfgs_jax.factor_graph.problem._graph import FactorGraph, check_values
from sfgs_jax.factor_graph.solver._linear_solvers import prepare_solve
from sfgs_jax.factor_graph.solver._normal_equations import build_normal_equations
from sfgs_jax.factor_graph.solver._schur_complement import landmark_steps, schur_complement

PCG_TOLERANCE, PCG_ITERATIONS = 1e-6, 1000


class Marginals(eqx.Module):
    """Covariances of single variables, on their tangents.

    Attributes:
        poses: (n, 6, 6), translation first, of perturbations on the right; metres and radians.
        landmarks: (m, 3, 3), m².
    """

    poses: Float[Array, "n 6 6"]
    landmarks: Float[Array, "m 3 3"]


@checked
def marginal_covariances(
    graph: FactorGraph,
    values: Values,
    *,
    poses: Int[np.ndarray, " n"] | None = None,
    landmarks: Int[np.ndarray, " m"] | None = None,
) -> Marginals:
    """Covariances of chosen poses and landmarks at an optimum: blocks of the inverse Hessian.

    A fixed variable has a covariance of zeros. The result is not finite, or very large, if the factors leave
    a direction free, for instance without a prior or a fixed pose.

    Args:
        graph: the graph that was solved.
        values: its optimum.
        poses: (n,) indices of poses, none if not given.
        landmarks: (m,) indices of landmarks, none if not given.

    Raises:
        InputError: numbers of poses or landmarks that don't match the graph's, or an index out of range.
    """
    check_values(graph, values)
    none = np.zeros(0, np.int32)
    chosen = [none if indices is None else np.asarray(indices, np.int32) for indices in (poses, landmarks)]
    for name, indices, count in zip(
        ("pose", "landmark"), chosen, (graph.num_poses, graph.num_landmarks), strict=True
    ):
        if np.any((indices < 0) | (indices >= count)):
            raise InputError(f"There is no {name} {indices.max()} in a graph of {count} {name}s.")
    return _marginals(graph, values, *chosen)


@jax.jit
def _marginals(graph: FactorGraph, values: Values, poses: Array, landmarks: Array) -> Marginals:
    equations = build_normal_equations(graph, values)
    dtype = values.poses.wxyz_xyz.dtype
    s, none = graph.structure, jnp.zeros((), dtype)
    linear_solve = partial(prepare_solve, pcg_tolerance=PCG_TOLERANCE, pcg_max_iterations=PCG_ITERATIONS)
    reduced, _, _ = schur_complement(graph, equations, none)
    solve = linear_solve(graph, reduced)
    eye = jnp.eye(6, dtype=dtype)

    def of_pose(index: Array) -> Array:
        columns = jax.vmap(lambda unit: solve(jnp.zeros((graph.num_poses, 6), dtype).at[index].set(unit)))(
            eye
        )
        block = columns[:, index]
        return jnp.where(jnp.asarray(graph.free_poses)[index], (block + block.T) / 2, 0)

    def of_landmark(index: Array) -> Array:
        place = jnp.asarray(s.cluster_landmarks) == index

        def column(unit: Array) -> Array:
            pull = jnp.where(place[..., None], -unit, 0)
            pushed = eqx.tree_at(
                lambda e: (e.gradient, e.landmark_gradient),
                equations,
                (jnp.zeros_like(equations.gradient), pull),
            )
            reduced, eliminated, _ = schur_complement(graph, pushed, none)
            return landmark_steps(graph, eliminated, solve(reduced.right))[index]

        block = jax.vmap(column)(jnp.eye(3, dtype=dtype))
        return jnp.where(jnp.asarray(graph.free_landmarks)[index], (block + block.T) / 2, 0)

    # One at a time: memory does not grow with their number.
    pose_blocks = jax.lax.map(of_pose, poses) if len(poses) else jnp.zeros((0, 6, 6), dtype)
    landmark_blocks = jax.lax.map(of_landmark, landmarks) if len(landmarks) else jnp.zeros((0, 3, 3), dtype)
    return Marginals(pose_blocks, landmark_blocks)
