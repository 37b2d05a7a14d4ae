"""Which loop closures to believe: pairwise consistency, and a threshold on residuals."""

import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.spatial.transform import Rotation

from sfgs_jax.factor_graph.factor import squared
from sfgs_jax.factor_graph.pose_factors import RelativePose
from sfgs_jax.factor_graph.values import Values
from sfgs_jax.geometry import se3

_Indices = Int[np.ndarray, "..."]


def consistent_loops(
    loops: RelativePose,
    odometry: Values,
    *,
    information: Float[Array | np.ndarray, "*n 6 6"] | None = None,
    max_square: float = 27.86,
) -> Bool[np.ndarray, " N"]:
    """Largest set of loop closures found that agree with one another.

    Two loops (a, b) and (c, d) close a cycle with the odometry from a to c and from d to b. They agree if
    that cycle comes back to where it began, within what both measurements and the odometry in between may be
    off: the squared Mahalanobis distance, with the covariance that grows along the chain. True loops agree
    with each other; false ones with hardly anything, so the largest clique of agreeing loops is the true set
    (Mangelson et al., Pairwise consistent measurement set maximization, ICRA 2018). It is searched for
    greedily from the loops with most partners, as an exact search is not polynomial. Time and memory grow as
    the number of pairs.

    Args:
        loops: N candidate closures with their information; masked ones are never kept.
        odometry: P poses before any loop was closed, in order of time.
        information: (P - 1, 6, 6) or (6, 6) of the motion from each pose to the next; if not given, the mean
            of the loops', as if the same sensor had measured both.
        max_square: the default is the 99.99 % quantile of chi-square with 6 degrees of freedom: a loop has
            to agree with all others, so hardly any true pair may fail.
    """
    T = se3.to_matrices(odometry.poses)
    valid = np.flatnonzero(loops.valid)
    kept = np.zeros(len(loops.valid), bool)
    if not len(valid):
        return kept
    a, b = np.asarray(loops.poses)[valid].T
    Z, matrices = se3.to_matrices(loops.T_a_b)[valid], np.asarray(loops.matrices, np.float64)[valid]
    steps = np.mean(matrices, axis=0) if information is None else information
    grown = _grown_covariance(T, _covariance(steps))
    # Where each loop says the world lies that the odometry has at b, seen from that at a: the same for all
    # true loops, but for noise, of which all counts in the world's frame.
    drift = T[a] @ Z @ np.linalg.inv(T[b])
    own = _carry(_adjoint(T[a] @ Z), _covariance(matrices))
    # From earlier to later: the ways between two loops are then the shortest.
    turned = (a > b)[:, None, None]
    back = np.linalg.inv(drift)
    own, drift = np.where(turned, _carry(_adjoint(back), own), own), np.where(turned, back, drift)
    a, b = np.minimum(a, b), np.maximum(a, b)
    across = _adjoint(drift)
    agree = np.zeros((len(valid), len(valid)), bool)
    for i in range(len(valid)):
        error = _log(drift @ np.linalg.inv(drift[i]))
        spread = own + own[i] + _around(grown, across, (a[[i]], a), (b, b[[i]]))
        square = np.einsum("ni,ni->n", error, np.linalg.solve(spread, error[:, :, None])[:, :, 0])
        agree[i] = square <= max_square
    kept[valid] = _clique(agree & agree.T)
    return kept


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


def _covariance(information: Float[Array | np.ndarray, "*n 6 6"]) -> Float[np.ndarray, "*n 6 6"]:
    """Inverse; directions without information get a deviation of a kilometre, or as many radians."""
    return np.linalg.inv(np.asarray(information, np.float64) + 1e-6 * np.eye(6))


def _grown_covariance(
    T: Float[np.ndarray, "P 4 4"], steps: Float[np.ndarray, "*n 6 6"]
) -> Float[np.ndarray, "P 6 6"]:
    """Covariance of each pose given the first, perturbed on the left; that between two is the difference."""
    grown = np.zeros((len(T), 6, 6))
    grown[1:] = np.cumsum(_carry(_adjoint(T[1:]), np.broadcast_to(steps, (len(T) - 1, 6, 6))), axis=0)
    return grown


def _around(
    grown: Float[np.ndarray, "P 6 6"],
    across: Float[np.ndarray, "N 6 6"],
    out: tuple[_Indices, _Indices],
    back: tuple[_Indices, _Indices],
) -> Float[np.ndarray, "N 6 6"]:
    """Covariance that the odometry brings to a cycle: along one way out, and back beyond a loop's drift.

    Steps that both ways take count once, with the sum of what they do, in which they mostly cancel if the
    ways go in opposite directions.
    """
    (p, q), (r, s) = out, back
    low, high = np.maximum(np.minimum(p, q), np.minimum(r, s)), np.minimum(np.maximum(p, q), np.maximum(r, s))
    shared = np.where((high > low)[:, None, None], grown[high] - grown[low], 0)
    turn = np.where((q > p) == (s > r), 1, -1)[:, None, None]
    first = grown[np.maximum(p, q)] - grown[np.minimum(p, q)] - shared
    second = grown[np.maximum(r, s)] - grown[np.minimum(r, s)] - shared
    return first + _carry(across, second) + _carry(np.eye(6) + turn * across, shared)


def _carry(
    by: Float[np.ndarray, "n 6 6"], covariance: Float[np.ndarray, "n 6 6"]
) -> Float[np.ndarray, "n 6 6"]:
    return by @ covariance @ np.swapaxes(by, 1, 2)


def _adjoint(T: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 6 6"]:
    """Ad(T), translation first."""
    R, t = T[:, :3, :3], T[:, :3, 3]
    adjoint = np.zeros((len(T), 6, 6))
    adjoint[:, :3, :3] = adjoint[:, 3:, 3:] = R
    adjoint[:, :3, 3:] = np.cross(t[:, None], np.swapaxes(R, 1, 2)).swapaxes(1, 2)
    return adjoint


def _log(T: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 6"]:
    """Tangents, in float64."""
    w = Rotation.from_matrix(T[:, :3, :3]).as_rotvec()
    t, angle = T[:, :3, 3], np.linalg.norm(w, axis=1, keepdims=True)
    half = np.maximum(angle, 1e-4) / 2  # below, the second-order term is less than rounding
    bend = (1 - half / np.tan(half)) / (2 * half) ** 2
    v = t - np.cross(w, t) / 2 + bend * np.cross(w, np.cross(w, t))
    return np.concatenate([v, w], axis=1)


def _clique(agree: Bool[np.ndarray, "N N"]) -> Bool[np.ndarray, " N"]:
    """A large clique: from each well connected vertex on, add the candidate with most partners."""
    best = np.zeros(len(agree), bool)
    for start in np.argsort(-agree.sum(axis=1), kind="stable")[:32]:
        chosen = np.arange(len(agree)) == start
        candidates = agree[start] & ~chosen
        partners = agree[:, candidates].sum(axis=1)
        while candidates.any():
            following = int(np.argmax(np.where(candidates, partners, -1)))
            chosen[following] = True
            left = candidates & agree[following]
            left[following] = False
            partners -= agree[:, candidates & ~left].sum(axis=1)
            candidates = left
        if chosen.sum() > best.sum():
            best = chosen
    return best
