"""Marginal covariances of chosen variables."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from sfgs_jax.factor_graph.graph import FactorGraph
from sfgs_jax.factor_graph.linear_solvers import prepare_solve
from sfgs_jax.factor_graph.normal_equations import landmark_steps, linearise, reduce
from sfgs_jax.factor_graph.values import Values

PCG_TOLERANCE, PCG_ITERATIONS = 1e-6, 1000


class Marginals(eqx.Module):
    """Covariances of single variables, on their tangents.

    Attributes:
        poses: (n, 6, 6), translation first, of perturbations on the right; metres and radians.
        landmarks: (m, 3, 3), m².
    """

    poses: Float[Array, "n 6 6"]
    landmarks: Float[Array, "m 3 3"]


def marginal_covariances(
    graph: FactorGraph,
    values: Values,
    *,
    poses: Int[np.ndarray, " n"] | None = None,
    landmarks: Int[np.ndarray, " m"] | None = None,
) -> Marginals:
    """Covariances of chosen poses and landmarks at an optimum: blocks of the inverse Hessian.

    Variables that are fixed have no covariance: zeros. Where the factors leave a direction free, as without a
    prior or a fixed pose, the result is not finite or very large: it has no covariance.

    Args:
        graph: the graph that was solved.
        values: its optimum.
        poses: which poses, none if not given.
        landmarks: which landmarks, none if not given.
    """
    none = np.zeros(0, np.int32)
    chosen = [none if indices is None else np.asarray(indices, np.int32) for indices in (poses, landmarks)]
    return _marginals(graph, values, *chosen)


@jax.jit
def _marginals(graph: FactorGraph, values: Values, poses: Array, landmarks: Array) -> Marginals:
    equations = linearise(graph, values)
    dtype = values.poses.wxyz_xyz.dtype
    s, none = graph.structure, jnp.zeros((), dtype)
    linear_solve = partial(prepare_solve, pcg_tolerance=PCG_TOLERANCE, pcg_max_iterations=PCG_ITERATIONS)
    reduced, _, _ = reduce(graph, equations, none)
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
            reduced, eliminated, _ = reduce(graph, pushed, none)
            return landmark_steps(graph, eliminated, solve(reduced.right))[index]

        block = jax.vmap(column)(jnp.eye(3, dtype=dtype))
        return jnp.where(jnp.asarray(graph.free_landmarks)[index], (block + block.T) / 2, 0)

    # One at a time: memory stays that of one solve, however many are asked for.
    pose_blocks = jax.lax.map(of_pose, poses) if len(poses) else jnp.zeros((0, 6, 6), dtype)
    landmark_blocks = jax.lax.map(of_landmark, landmarks) if len(landmarks) else jnp.zeros((0, 3, 3), dtype)
    return Marginals(pose_blocks, landmark_blocks)
