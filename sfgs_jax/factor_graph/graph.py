"""A factor graph: blocks of factors, which variables are free, and where everything goes."""

from collections.abc import Sequence
from typing import Any, Literal

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Int

from sfgs_jax.factor_graph.anchor import find_anchor
from sfgs_jax.factor_graph.capacities import Capacities
from sfgs_jax.factor_graph.factor import Factor
from sfgs_jax.factor_graph.nested_dissection import EliminationPlan, plan_elimination
from sfgs_jax.factor_graph.structure import ALL_PAIRS, Structure, lay_out
from sfgs_jax.geometry import InputError

LinearSolver = Literal["dense", "sparse", "pcg"]


class FactorGraph(eqx.Module):
    """Factors over P poses and L landmarks.

    Built on the host, from indices that are known there; measurements may be traced. Every array may be
    padded: rows of factors with their `valid`, variables by leaving them out of `free_poses`. Two graphs of
    equal shapes and capacities run the same compiled program.

    Attributes:
        factors: blocks, one per type.
        free_poses: (P,) poses to solve for; the others are fixed, or padding.
        free_landmarks: (L,) landmarks to solve for.
        anchor: the pose that holds the others in place, if nothing else does, else None: see `find_anchor`.
        structure: where each factor's blocks go.
        plan: order of elimination of the sparse solver, else None.
        linear_solver: how the reduced normal equations are solved; static.
    """

    factors: tuple[Factor, ...]
    free_poses: Bool[Array | np.ndarray, " P"]
    free_landmarks: Bool[Array | np.ndarray, " L"]
    anchor: Int[Array | np.ndarray, ""] | None
    structure: Structure
    plan: EliminationPlan | None
    linear_solver: LinearSolver = eqx.field(static=True)

    def __init__(
        self,
        factors: Sequence[Factor],
        *,
        num_poses: int,
        num_landmarks: int = 0,
        free_poses: Any = None,
        free_landmarks: Any = None,
        linear_solver: LinearSolver | Literal["auto"] = "auto",
        capacities: Capacities | None = None,
    ):
        """Lay a graph out.

        Args:
            factors: blocks; several of one type are fine.
            num_poses: P, capacity included.
            num_landmarks: L, capacity included.
            free_poses: (P,) which to solve for, all if not given.
            free_landmarks: (L,) which to solve for, all if not given.
            linear_solver: "dense" Cholesky, "sparse" multifrontal Cholesky after nested dissection, or
                "pcg" (block-Jacobi conjugate gradients); "auto" is dense up to 128 poses, else sparse.
            capacities: those of the graph that this one grew from, so that it needs no new program.

        Raises:
            InputError: an index out of range, or shapes that don't match.
        """
        self.factors = tuple(factors)
        self.free_poses = _mask(free_poses, num_poses, "free_poses")
        self.free_landmarks = _mask(free_landmarks, num_landmarks, "free_landmarks")
        if num_poses < 1:
            raise InputError("A factor graph needs at least one pose.")
        for factor in self.factors:
            _check(factor, num_poses, num_landmarks)
        self.anchor = find_anchor(self.factors, self.free_poses)
        capacities = capacities or Capacities()
        self.structure = lay_out(self.factors, num_poses, num_landmarks, capacities)
        if linear_solver == "auto":
            linear_solver = "dense" if num_poses <= ALL_PAIRS else "sparse"
        self.linear_solver = linear_solver
        self.plan = None
        if linear_solver == "sparse":
            rows, columns = np.asarray(self.structure.rows), np.asarray(self.structure.columns)
            self.plan = plan_elimination(rows, columns, num_poses, capacities.batches)

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
        return Capacities(self.structure.rows.shape[0], clusters, width, batches)


def _mask(given: Any, count: int, name: str) -> np.ndarray:
    mask = np.ones(count, bool) if given is None else np.asarray(given, bool)
    if mask.shape != (count,):
        raise InputError(f"{name} has shape {mask.shape}; it needs one entry for each of {count}.")
    return mask


def _check(factor: Factor, num_poses: int, num_landmarks: int) -> None:
    name, valid = type(factor).__name__, np.asarray(factor.valid)
    poses = np.asarray(factor.poses)[valid]
    if poses.size and (poses.min() < 0 or poses.max() >= num_poses):
        raise InputError(f"{name} touches pose {poses.max()}, but the graph has {num_poses} poses.")
    if factor.landmarks is not None:
        landmarks = np.asarray(factor.landmarks)[valid]
        if landmarks.size and (landmarks.min() < 0 or landmarks.max() >= num_landmarks):
            raise InputError(
                f"{name} touches landmark {landmarks.max()}, but the graph has {num_landmarks} landmarks."
            )
