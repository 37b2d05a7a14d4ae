"""Rigid motion from matched points, robust against wrong matches."""

from functools import partial
from typing import Literal, NamedTuple, assert_never

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import optimistix
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Key

from sfgs_jax.geometry import InputError, se3
from sfgs_jax.gicp.frames import Frames
from sfgs_jax.gicp.horn import closed_form
from sfgs_jax.gicp.padding import padded

Method = Literal["least_squares", "graduated", "ransac"]
_GRADUATIONS = 40
_GRADUATION = 1.4
_REFINEMENTS = 24


class RigidResult(eqx.Module):
    """A rigid motion with the matches that support it.

    Attributes:
        T_target_source: the motion found.
        inliers: (N,) matches that it brings closer than the limit; all usable ones for `least_squares`.
        num_inliers: how many.
        rmse: root mean square distance of the inliers, metres.
        unique: the inliers fix the motion: there are three or more, not on a line.
        converged: it is unique and supported by at least the share of the matches asked for.
    """

    T_target_source: jaxlie.SE3
    inliers: Bool[Array, " N"]
    num_inliers: Int[Array, ""]
    rmse: Float[Array, ""]
    unique: Bool[Array, ""]
    converged: Bool[Array, ""]


def rigid_from_matches(
    source_points: Float[Array | np.ndarray, "N 3"],
    target_points: Float[Array | np.ndarray, "M 3"],
    weights: Float[Array | np.ndarray, " W"] | None = None,
    *,
    valid: Bool[Array | np.ndarray, " V"] | None = None,
    method: Method = "graduated",
    max_distance: float = 0.05,
    min_inlier_fraction: float = 0.1,
    hypotheses: int = 256,
    key: Key[Array, ""] | None = None,
    refined: bool = True,
) -> RigidResult:
    """Motion R, t that lays matched points on each other: argmin sum w ||R p + t - q||².

    - `least_squares`: that sum over all matches, in closed form.
    - `graduated`: graduated non-convexity with truncated squares: Yang et al., Graduated non-convexity for
      robust spatial perception (RA-L 2020), algorithm 1, eq. 12 to 14. Bears 60 % of wrong matches.
    - `ransac`: the best of `hypotheses` motions from three matches each, drawn by `key`. With a share w of
      right matches it misses with a probability of (1 - w³)^hypotheses: 0.1 % at w = 0.3 and 256.

    The robust methods then minimise the sum of Tukey's kernel of the distances over all matches with
    optimistix' Levenberg-Marquardt, from where they are. No number of matches makes a NaN.
    The motion is differentiable with respect to points and weights, by the implicit function theorem at that
    minimum.

    Args:
        source_points: p, metres; a row that is not finite is no match.
        target_points: q, metres.
        weights: at least 0, such as inverse variances; 1 if not given.
        valid: which rows are matches, all if not given.
        method: see above; static.
        max_distance: an inlier is brought closer than this, metres.
        min_inlier_fraction: least share of the matches that must be inliers for `converged`.
        hypotheses: of `ransac`; static.
        key: random key, for `ransac` only.
        refined: False leaves out the last minimisation, and with it the derivatives: for a motion that is
            only a start it takes most of the time; static.

    Raises:
        InputError: the lists differ in length, or `ransac` has no key.
    """
    counts = {source_points.shape[0], target_points.shape[0]}
    counts |= {x.shape[0] for x in (weights, valid) if x is not None}
    if len(counts) != 1:
        raise InputError(f"Matches have one row each in all lists, but these have {sorted(counts)} rows.")
    if method == "ransac" and key is None:
        raise InputError("RANSAC draws its hypotheses at random: give it a key, such as jax.random.key(0).")
    p, q = jnp.asarray(source_points), jnp.asarray(target_points)
    used = jnp.ones(p.shape[0], bool) if valid is None else jnp.asarray(valid)
    given = jnp.ones(p.shape[0], p.dtype) if weights is None else jnp.asarray(weights)
    rows = (padded(x) for x in (p, q, given, used))
    key = jax.random.key(0) if key is None else key
    result = _rigid(*rows, key, max_distance, min_inlier_fraction, method, hypotheses, refined)
    return eqx.tree_at(lambda r: r.inliers, result, result.inliers[: p.shape[0]])


@partial(jax.jit, static_argnames=("method", "hypotheses", "refined"))
def _rigid(
    p: Float[Array, "N 3"],
    q: Float[Array, "N 3"],
    weights: Float[Array, " N"],
    valid: Bool[Array, " N"],
    key: Key[Array, ""],
    limit: float | Array,
    min_fraction: float | Array,
    method: Method,
    hypotheses: int,
    refined: bool,
) -> RigidResult:
    used = valid & jnp.all(jnp.isfinite(p) & jnp.isfinite(q), axis=1) & jnp.isfinite(weights) & (weights > 0)
    p, q = jnp.where(used[:, None], p, 0), jnp.where(used[:, None], q, 0)
    weights = jnp.where(used, weights, 0)
    # Around their means the points are small numbers, which float32 holds well.
    share = used.astype(p.dtype) / jnp.maximum(jnp.sum(used), 1).astype(p.dtype)
    frames = Frames(lax.stop_gradient(share @ p), lax.stop_gradient(share @ q))
    matches = Matches(
        jnp.where(used[:, None], p - frames.source, 0),
        jnp.where(used[:, None], q - frames.target, 0),
        weights,
        used,
    )
    fixed = lax.stop_gradient(matches)
    limit = jnp.asarray(limit, p.dtype)
    match method:
        case "least_squares":
            T, _ = closed_form(fixed.source, fixed.target, fixed.weights)
        case "graduated":
            T = _graduated(fixed, limit)
        case "ransac":
            T = _fit(fixed, _consensus(fixed, limit, key, hypotheses), limit)
        case _:
            assert_never(method)
    if refined:
        T = _refined(matches, T, None if method == "least_squares" else limit)

    square = fixed.squares(lax.stop_gradient(T))
    inliers = used if method == "least_squares" else used & (square < limit**2)
    number = jnp.sum(inliers, dtype=jnp.int32)
    weight = jnp.where(inliers, 1, 0).astype(p.dtype)
    rmse = jnp.sqrt(weight @ square / jnp.maximum(jnp.sum(weight), 1))
    _, unique = closed_form(fixed.source, fixed.target, weight)
    enough = jnp.sum(weight) >= jnp.maximum(
        3, jnp.asarray(min_fraction, p.dtype) * jnp.sum(used.astype(p.dtype))
    )
    return RigidResult(frames.given(T), inliers, number, rmse, unique, unique & enough)


class Matches(eqx.Module):
    """Matched points, centred: source and target (N, 3), weights (N,) and mask (N,)."""

    source: Float[Array, "N 3"]
    target: Float[Array, "N 3"]
    weights: Float[Array, " N"]
    used: Bool[Array, " N"]

    def squares(self, T: jaxlie.SE3) -> Float[Array, " N"]:
        """Squared distances between the moved sources and their targets."""
        return jnp.sum((se3.transform(T, self.source) - self.target) ** 2, axis=1)


def _fit(matches: Matches, T: jaxlie.SE3, limit: Float[Array, ""]) -> jaxlie.SE3:
    """Closed form over the inliers of a motion."""
    inliers = matches.squares(T) < limit**2
    return closed_form(matches.source, matches.target, jnp.where(inliers, matches.weights, 0))[0]


class _Graduation(NamedTuple):
    """Graduated non-convexity after a step: the motion, the weights it is made with, and what comes next."""

    T: jaxlie.SE3
    robust: Float[Array, " N"]
    control: Float[Array, ""]
    step: Int[Array, ""]
    settled: Bool[Array, ""]


def _graduated(matches: Matches, limit: Float[Array, ""]) -> jaxlie.SE3:
    start, _ = closed_form(matches.source, matches.target, matches.weights)
    largest = jnp.max(jnp.where(matches.used, matches.squares(start), 0))
    # Below this the surrogate of the cost is convex; nothing is to be graduated if all are inliers already.
    first = limit**2 / jnp.maximum(2 * largest - limit**2, 1e-6 * limit**2)

    def unfinished(state: _Graduation) -> Bool[Array, ""]:
        return (state.step < _GRADUATIONS) & ~state.settled

    def step(state: _Graduation) -> _Graduation:
        square, control = matches.squares(state.T), state.control
        low, high = control / (control + 1) * limit**2, (control + 1) / control * limit**2
        between = limit * jnp.sqrt(control * (control + 1) / jnp.maximum(square, low)) - control
        robust = jnp.where(square <= low, 1, jnp.where(square >= high, 0, between))
        T, _ = closed_form(matches.source, matches.target, matches.weights * robust)
        # Once every match stays in or out, all further steps find this motion: their bands only get narrower.
        settled = jnp.all((robust == state.robust) & ((square <= low) | (square >= high)))
        return _Graduation(T, robust, jnp.minimum(control * _GRADUATION, 1e6), state.step + 1, settled)

    begin = _Graduation(start, jnp.ones_like(matches.weights), first, jnp.asarray(0), jnp.asarray(False))
    return lax.while_loop(unfinished, step, begin).T


def _consensus(matches: Matches, limit: Float[Array, ""], key: Key[Array, ""], hypotheses: int) -> jaxlie.SE3:
    """Of motions by three matches drawn at random the one with the least sum of truncated squares."""
    triples = _triples(matches.used, key, hypotheses)
    one = jnp.ones(3, matches.source.dtype)
    motions, unique = jax.vmap(lambda p, q: closed_form(p, q, one))(
        matches.source[triples], matches.target[triples]
    )
    costs = jax.vmap(lambda T: matches.weights @ jnp.minimum(matches.squares(T), limit**2))(motions)
    best = jnp.argmin(jnp.where(unique, costs, jnp.inf))
    return jax.tree.map(lambda x: x[best], motions)


def _triples(used: Bool[Array, " N"], key: Key[Array, ""], number: int) -> Int[Array, "H 3"]:
    """Triples of different matches, as long as there are three."""
    count = jnp.sum(used, dtype=jnp.int32)
    left = jnp.maximum(count - jnp.arange(3, dtype=jnp.int32), 1)
    a, b, c = jnp.minimum(
        jnp.floor(jax.random.uniform(key, (number, 3)) * left.astype(jnp.float32)).astype(jnp.int32), left - 1
    ).T
    # The second is drawn from what the first leaves, the third from what both leave.
    b = jnp.where(b >= a, b + 1, b)
    low, high = jnp.minimum(a, b), jnp.maximum(a, b)
    c = jnp.where(c >= low, c + 1, c)
    c = jnp.where(c >= high, c + 1, c)
    places = jnp.argsort(~used, stable=True)
    return places[jnp.minimum(jnp.stack([a, b, c], axis=1), used.shape[0] - 1)]


def _refined(matches: Matches, T: jaxlie.SE3, limit: Float[Array, ""] | None) -> jaxlie.SE3:
    """Nearby minimum of the weighted squares, or of Tukey's kernel of them, with its derivatives."""

    def residuals(
        delta: Float[Array, "6"], args: tuple[Matches, jaxlie.SE3, Float[Array, ""] | None]
    ) -> tuple[Float[Array, "N 3"], Float[Array, "6"]]:
        matches, T, limit = args
        offsets = se3.transform(se3.compose(T, se3.exp(delta)), matches.source) - matches.target
        factor = matches.weights
        if limit is not None:
            # Tukey's rho(s) / s is smooth and positive, so that its root times the offset squares to rho.
            s = jnp.sum(offsets**2, axis=1) / limit**2
            near = 1 - jnp.minimum(s, 1) + jnp.minimum(s, 1) ** 2 / 3
            factor = factor * jnp.where(s < 1, near, 1 / (3 * jnp.maximum(s, 1)))
        root = jnp.where(matches.used, jnp.sqrt(jnp.where(matches.used, factor, 1)), 0)
        # What no match fixes stays where it is.
        anchor = 1e-3 * jnp.sqrt(jnp.maximum(jnp.sum(matches.weights), 1e-6))
        return root[:, None] * offsets, lax.stop_gradient(anchor) * delta

    # The derivatives are those of the minimum, so the steps go on until rounding ends them.
    tolerance = 10 * float(jnp.finfo(matches.source.dtype).eps)
    solution = optimistix.least_squares(
        residuals,
        optimistix.LevenbergMarquardt(rtol=tolerance, atol=tolerance),
        jnp.zeros(6, matches.source.dtype),
        (matches, lax.stop_gradient(T), limit),
        max_steps=_REFINEMENTS,
        throw=False,
    )
    return se3.compose(lax.stop_gradient(T), se3.exp(solution.value))
