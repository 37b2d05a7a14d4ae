"""A factor graph: blocks of factors, its free variables, and the layout of its normal equations."""

from collections.abc import Sequence
from typing import Literal, get_args

import equinox as eqx
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Int

from sfgs_jax.arrays import InputError
from sfgs_jax.factor_graph._values import Values
from sfgs_jax.factor_graph.factors._factor import Factor
from sfgs_jax.factor_graph.problem._capacities import Capacities
from sfgs_jax.factor_graph.problem._elimination_plan import EliminationPlan, plan_elimination
from sfgs_jax.factor_graph.problem._gauge import find_gauge_pose
from sfgs_jax.factor_graph.problem._layout import ALL_PAIRS, Structure, lay_out

LinearSolver = Literal["dense", "sparse", "pcg"]


class FactorGraph(eqx.Module):
    """Factors over P poses and L landmarks.

    A graph is built on the host, from indices that are known there; measurements may be traced. It is a
    pytree, so a compiled function takes it as an argument. Every array may be padded: rows of factors with
    their `valid`, variables by leaving them out of `free_poses`. Two graphs of equal shapes and capacities
    run the same compiled program.

    Attributes:
        factors: blocks, one per type.
        free_poses: (P,) poses to solve for; the others are fixed, or padding.
        free_landmarks: (L,) landmarks to solve for.
        gauge_pose: the one fixed pose of a connected graph of relative factors, else None. The solver frees
            it, and in the end moves all poses to bring it back.
        structure: place of each factor's blocks.
        plan: elimination plan of the sparse solver, else None.
        linear_solver: solver of the reduced normal equations; static.
    """

    factors: tuple[Factor, ...]
    free_poses: Bool[Array | np.ndarray, " P"]
    free_landmarks: Bool[Array | np.ndarray, " L"]
    gauge_pose: Int[Array | np.ndarray, ""] | None
    structure: Structure
    plan: EliminationPlan | None
    linear_solver: LinearSolver = eqx.field(static=True)

    def __init__(
        self,
        factors: Sequence[Factor],
        *,
        num_poses: int,
        num_landmarks: int = 0,
        free_poses: Bool[ArrayLike, " P"] | Sequence[bool] | None = None,
        free_landmarks: Bool[ArrayLike, " L"] | Sequence[bool] | None = None,
        linear_solver: LinearSolver | Literal["auto"] = "auto",
        capacities: Capacities | None = None,
    ):
        """Lay a graph out.

        Args:
            factors: blocks; several of one type are fine.
            num_poses: P, capacity included.
            num_landmarks: L, capacity included.
            free_poses: (P,) poses to solve for, all if not given.
            free_landmarks: (L,) landmarks to solve for, all if not given.
            linear_solver: "dense" Cholesky, "sparse" multifrontal Cholesky after nested dissection, or
                "pcg" (block-Jacobi conjugate gradients); "auto" is dense up to 128 poses, else sparse.
            capacities: the `capacities` of the graph that this one grew from, to run its program again.

        Raises:
            InputError: an index out of range, shapes that don't match, or an unknown solver.
        """
        if num_poses < 1:
            raise InputError("A factor graph needs at least one pose.")
        if linear_solver not in (*get_args(LinearSolver), "auto"):
            names = ", ".join(get_args(LinearSolver))
            raise InputError(f"There is no linear solver {linear_solver!r}; choose auto, {names}.")
        self.factors = tuple(factors)
        self.free_poses = _mask(free_poses, num_poses, "free_poses")
        self.free_landmarks = _mask(free_landmarks, num_landmarks, "free_landmarks")
        for factor in self.factors:
            _check_indices(factor, num_poses, num_landmarks)
        self.gauge_pose = find_gauge_pose(self.factors, self.free_poses)
        capacities = capacities or Capacities()
        self.structure = lay_out(self.factors, num_poses, num_landmarks, capacities)
        if linear_solver == "auto":
            linear_solver = "dense" if num_poses <= ALL_PAIRS else "sparse"
        self.linear_solver = linear_solver
        self.plan = None
        if linear_solver == "sparse":
            rows, columns = np.asarray(self.structure.rows), np.asarray(self.structure.columns)
            self.plan = plan_elimination(rows, columns, num_poses, capacities.batches, capacities.least_front)

    @property
    def num_poses(self) -> int:
        """P."""
        return self.free_poses.shape[0]

    @property
    def num_landmarks(self) -> int:
        """L."""
        return self.free_landmarks.shape[0]

    @property
    def capacities(self) -> Capacities:
        """Sizes to pass on to the next graph."""
        clusters, width = self.structure.cluster_poses.shape
        batches = () if self.plan is None else self.plan.sizes
        return Capacities(
            blocks=self.structure.rows.shape[0], clusters=clusters, cluster_poses=width, batches=batches
        )


def check_values(graph: FactorGraph, values: Values) -> None:
    """Refuse values with other numbers of poses or landmarks than the graph's.

    Args:
        graph: graph to solve.
        values: values to start from; they may be traced.

    Raises:
        InputError: shapes that don't match.
    """
    poses, landmarks = values.poses.wxyz_xyz.shape, values.landmarks.shape
    P, L = graph.num_poses, graph.num_landmarks
    if (poses, landmarks) != ((P, 7), (L, 3)):
        raise InputError(
            f"The values hold {poses[0]} poses and {landmarks[0]} landmarks, the graph {P} and {L}; "
            f"the values need shapes ({P}, 7) and ({L}, 3)."
        )


def _mask(
    given: Bool[ArrayLike, " n"] | Sequence[bool] | None, count: int, name: str
) -> Bool[np.ndarray, " n"]:
    mask = np.ones(count, bool) if given is None else np.asarray(given, bool)
    if mask.shape != (count,):
        raise InputError(f"{name} has shape {mask.shape}; it needs one entry for each of {count}.")
    return mask


def _check_indices(factor: Factor, num_poses: int, num_landmarks: int) -> None:
    """Refuse rows that count and have an index out of range."""
    valid = np.asarray(factor.valid)
    for name, indices, count in (
        ("pose", factor.poses, num_poses),
        ("landmark", factor.landmarks, num_landmarks),
    ):
        if indices is None:
            continue
        used = np.asarray(indices)[valid]
        wrong = used[(used < 0) | (used >= count)]
        if wrong.size:
            kind = type(factor).__name__
            raise InputError(f"{kind} touches {name} {wrong.max()}, but the graph has {count} {name}s.")
