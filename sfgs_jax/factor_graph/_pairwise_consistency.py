"""Pairwise consistency maximisation of loop closures, and a threshold on their residuals."""

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.arrays import checked
from sfgs_jax.factor_graph._values import Values
from sfgs_jax.factor_graph.factors._factor import squared_mahalanobis
from sfgs_jax.factor_graph.factors._pose_factors import RelativePose
from sfgs_jax.geometry import se3

CLIQUE_STARTS = 32
"""Vertices, those with most neighbours, from which a clique is grown."""

_Indices = Int[np.ndarray, "..."]


@checked
def consistent_loops(
    loops: RelativePose,
    odometry: Values,
    *,
    information: Float[Array | np.ndarray, "*n 6 6"] | None = None,
    max_square: float = 27.86,
) -> Bool[np.ndarray, " N"]:
    """Pairwise consistency maximisation: the largest set found of loop closures that agree with one another.

    Two loops (a, b) and (c, d) close a cycle with the odometry from a to c and from d to b. They agree if the
    motion around the cycle is the identity within its noise. The test is on the squared Mahalanobis distance;
    the covariance sums both measurements and the odometry between them. True loops agree with each other, and
    false loops with hardly any, so the largest clique of agreeing loops is the true set (Mangelson et al.,
    Pairwise consistent measurement set maximization, ICRA 2018).

    An exact search for the clique is not polynomial; this one is greedy, from the loops that agree with most
    others. Time and memory grow as the number of pairs.

    Args:
        loops: N candidate closures with their information; masked ones are never kept.
        odometry: P poses before any loop was closed, in order of time.
        information: (P - 1, 6, 6) or (6, 6) of the motion from each pose to the next. If not given, the mean
            of the loops', which assumes one sensor for both.
        max_square: greatest squared distance of a pair that agrees. The default is the 99.99 % quantile of
            chi-square with 6 degrees of freedom: a loop has to agree with all others, so hardly any true pair
            may fail.
    """
    T = se3.to_matrices(odometry.poses)
    valid = np.flatnonzero(loops.valid)
    kept = np.zeros(len(loops.valid), bool)
    if not len(valid):
        return kept
    a, b = np.asarray(loops.poses)[valid].T
    Z, matrices = se3.to_matrices(loops.T_a_b)[valid], np.asarray(loops.matrices, np.float64)[valid]
    steps = np.mean(matrices, axis=0) if information is None else information
    accumulated = _accumulated_covariance(T, _covariance(steps))
    # The drift of the odometry between a and b, by each loop, in the world's frame. Without noise, all true
    # loops agree on it. Covariances are in the same frame.
    drift = T[a] @ Z @ np.linalg.inv(T[b])
    own = _transported(_covariance(matrices), se3.adjoints_of(T[a] @ Z))
    # All loops from the earlier pose to the later: the odometry between two loops is then the shortest.
    reversed_ = (a > b)[:, None, None]
    back = np.linalg.inv(drift)
    own = np.where(reversed_, _transported(own, se3.adjoints_of(back)), own)
    drift = np.where(reversed_, back, drift)
    a, b = np.minimum(a, b), np.maximum(a, b)
    across = se3.adjoints_of(drift)
    agree = np.zeros((len(valid), len(valid)), bool)
    for i in range(len(valid)):
        error = se3.logs_of(drift @ np.linalg.inv(drift[i]))
        spread = own + own[i] + _odometry_covariance(accumulated, across, (a[[i]], a), (b, b[[i]]))
        square = np.einsum("ni,ni->n", error, np.linalg.solve(spread, error[:, :, None])[:, :, 0])
        agree[i] = square <= max_square
    kept[valid] = _greedy_clique(agree & agree.T)
    return kept


@checked
def within_threshold(
    loops: RelativePose, values: Values, *, max_square: float = 16.81
) -> Bool[np.ndarray, " N"]:
    """Loop closures with a squared whitened residual below a threshold; masked ones are not among them.

    Args:
        loops: N closures.
        values: poses, usually those of a robust solve.
        max_square: the threshold; the default is the 99 % quantile of chi-square with 6 degrees of freedom.
    """
    square: Float[np.ndarray, " N"] = np.asarray(squared_mahalanobis(*loops.residuals(values)))
    return np.asarray(loops.valid) & (square <= max_square)


def _covariance(information: Float[Array | np.ndarray, "*n 6 6"]) -> Float[np.ndarray, "*n 6 6"]:
    """Inverse; directions without information get a deviation of 1000 metres or radians."""
    return np.linalg.inv(np.asarray(information, np.float64) + 1e-6 * np.eye(6))


def _accumulated_covariance(
    T: Float[np.ndarray, "P 4 4"], steps: Float[np.ndarray, "*n 6 6"]
) -> Float[np.ndarray, "P 6 6"]:
    """Covariance of each pose given the first, perturbed on the left; the difference is that between two."""
    sums = np.zeros((len(T), 6, 6))
    each = np.broadcast_to(steps, (len(T) - 1, 6, 6))
    sums[1:] = np.cumsum(_transported(each, se3.adjoints_of(T[1:])), axis=0)
    return sums


def _odometry_covariance(
    accumulated: Float[np.ndarray, "P 6 6"],
    across: Float[np.ndarray, "N 6 6"],
    out: tuple[_Indices, _Indices],
    back: tuple[_Indices, _Indices],
) -> Float[np.ndarray, "N 6 6"]:
    """Covariance of the odometry in a cycle: along one way out, and along the other back, beyond the drift.

    Steps on both ways count once, as the sum of their effects. These mostly cancel if the ways go in opposite
    directions.

    Args:
        accumulated: (P, 6, 6) covariance of each pose given the first.
        across: (N, 6, 6) adjoint of the drift of each loop.
        out: first and last pose of the way out.
        back: first and last pose of the way back.
    """
    (p, q), (r, s) = out, back
    low, high = np.maximum(np.minimum(p, q), np.minimum(r, s)), np.minimum(np.maximum(p, q), np.maximum(r, s))
    shared = np.where((high > low)[:, None, None], accumulated[high] - accumulated[low], 0)
    sign = np.where((q > p) == (s > r), 1, -1)[:, None, None]
    first = accumulated[np.maximum(p, q)] - accumulated[np.minimum(p, q)] - shared
    second = accumulated[np.maximum(r, s)] - accumulated[np.minimum(r, s)] - shared
    return first + _transported(second, across) + _transported(shared, np.eye(6) + sign * across)


def _transported(
    covariance: Float[np.ndarray, "n 6 6"], by: Float[np.ndarray, "n 6 6"]
) -> Float[np.ndarray, "n 6 6"]:
    """Covariance of a linearly transformed tangent, J C J^T."""
    return by @ covariance @ np.swapaxes(by, 1, 2)


def _greedy_clique(agree: Bool[np.ndarray, "N N"]) -> Bool[np.ndarray, " N"]:
    """A large clique: grown from each well connected vertex by the candidate with most neighbours left."""
    best = np.zeros(len(agree), bool)
    for start in np.argsort(-agree.sum(axis=1), kind="stable")[:CLIQUE_STARTS]:
        chosen = np.arange(len(agree)) == start
        candidates = agree[start] & ~chosen
        neighbours = agree[:, candidates].sum(axis=1)
        while candidates.any():
            following = int(np.argmax(np.where(candidates, neighbours, -1)))
            chosen[following] = True
            left = candidates & agree[following]
            left[following] = False
            neighbours -= agree[:, candidates & ~left].sum(axis=1)
            candidates = left
        if chosen.sum() > best.sum():
            best = chosen
    return best
