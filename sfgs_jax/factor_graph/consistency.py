"""Which loop closures to believe: pairwise consistency, and a threshold on residuals."""

import numpy as np
from jaxtyping import Bool, Float

from sfgs_jax.factor_graph.factor import squared
from sfgs_jax.factor_graph.pose_factors import RelativePose
from sfgs_jax.factor_graph.values import Values
from sfgs_jax.geometry import se3


def consistent_loops(
    loops: RelativePose,
    odometry: Values,
    *,
    metres: float = 0.05,
    radians: float = 0.02,
    drift_metres: float = 0.01,
    drift_radians: float = 0.002,
) -> Bool[np.ndarray, " N"]:
    """Largest set of loop closures found that agree with one another.

    Two loops (a, b) and (c, d) close a cycle with the odometry from a to c and from d to b. They agree if
    that cycle comes back to where it began, within what both measurements and the odometry in between may be
    off. True loops agree with each other; false ones with hardly anything, so the largest clique of agreeing
    loops is the true set (Mangelson et al., Pairwise consistent measurement set maximization, ICRA 2018). It
    is searched for greedily from the loop with most partners, as an exact search is not polynomial.

    Args:
        loops: N candidate closures; masked ones are never kept.
        odometry: poses before any loop was closed, in order of time.
        metres: how far off a pair of measurements may be.
        radians: the same for the angle.
        drift_metres: what each step of the odometry adds, growing with the root of their number.
        drift_radians: the same for the angle.
    """
    T = se3.to_matrices(odometry.poses)
    valid = np.asarray(loops.valid)
    ends = np.where(valid[:, None], np.asarray(loops.poses), 0)
    measured = se3.to_matrices(loops.T_a_b)
    # Where each loop says the world of b lies in that of a: the same for all true loops, but for drift.
    a, b = T[ends[:, 0]], T[ends[:, 1]]
    agree = np.zeros((len(valid), len(valid)), bool)
    for i in np.flatnonzero(valid):
        # Around the cycle, seen from b of loop i: b_i -> a_i -> a_j -> b_j -> b_i.
        along = np.linalg.inv(measured[i]) @ np.linalg.inv(a[i]) @ a @ measured
        cycle = along @ np.linalg.inv(b) @ b[i]
        steps = np.abs(ends[:, 0] - ends[i, 0]) + np.abs(ends[:, 1] - ends[i, 1])
        cosine = np.clip((np.trace(cycle[:, :3, :3], axis1=1, axis2=2) - 1) / 2, -1, 1)
        near = np.linalg.norm(cycle[:, :3, 3], axis=1) <= metres + drift_metres * np.sqrt(steps)
        agree[i] = near & (np.arccos(cosine) <= radians + drift_radians * np.sqrt(steps)) & valid
    agree = agree & agree.T
    return _clique(agree) & valid


def within_threshold(
    loops: RelativePose, values: Values, *, max_square: float = 16.81
) -> Bool[np.ndarray, " N"]:
    """Loop closures whose squared whitened residual stays under a threshold; masked ones don't.

    Args:
        loops: N closures.
        values: where to look, usually after a robust solve.
        max_square: the default is the 99 % quantile of chi-square with 6 degrees of freedom.
    """
    square: Float[np.ndarray, " N"] = np.asarray(squared(*loops.residuals(values)))
    return np.asarray(loops.valid) & (square <= max_square)


def _clique(agree: Bool[np.ndarray, "N N"]) -> Bool[np.ndarray, " N"]:
    """A large clique: from each well connected vertex on, add the candidate with most partners."""
    best = np.zeros(len(agree), bool)
    degree = agree.sum(axis=1)
    for start in np.argsort(-degree)[:32]:
        chosen = np.zeros(len(agree), bool)
        candidates = agree[start].copy()
        chosen[start] = agree[start, start]
        candidates[start] = False
        while candidates.any():
            partners = (agree[:, candidates].sum(axis=1) + 1) * candidates
            following = int(np.argmax(partners))
            chosen[following] = True
            candidates &= agree[following]
            candidates[following] = False
        if chosen.sum() > best.sum():
            best = chosen
    return best
