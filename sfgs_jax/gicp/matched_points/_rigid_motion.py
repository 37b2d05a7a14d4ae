"""Rigid motion from matched points, robust against wrong matches."""

from functools import partial
from typing import Literal, assert_never

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import optimistix
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Key

from sfgs_jax.arrays import InputError, Text, checked, padded, printed_count, printed_fields
from sfgs_jax.geometry import se3
from sfgs_jax.gicp._centred_frames import CentredFrames
from sfgs_jax.gicp._exact_products import exact_products
from sfgs_jax.gicp.matched_points._horn import absolute_orientation

Method = Literal["least_squares", "graduated", "ransac"]

_GRADUATION_STEPS = 40
_GRADUATION_FACTOR = 1.4
"""Growth of the control parameter in each step of graduated non-convexity."""

_REFINEMENT_STEPS = 24


class RigidResult(eqx.Module):
    """A rigid motion with the matches that support it.

    Attributes:
        T_target_source: the motion found.
        inliers: (N,) matches that it brings closer than the limit; all usable ones for `least_squares`.
        num_inliers: number of them.
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

    def __repr__(self) -> str:
        return printed_fields(
            "RigidResult",
            rmse=(self.rmse, "m"),
            T_target_source=Text(se3.text_of(self.T_target_source)),
            inliers=Text(printed_count(self.inliers)),
            unique=self.unique,
            converged=self.converged,
        )


@checked
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

    - `least_squares`: the sum over all matches, in closed form.
    - `graduated`: graduated non-convexity with truncated least squares. It bears 60 % of wrong matches.
      Source: Yang et al., Graduated non-convexity for robust spatial perception (RA-L 2020), algorithm 1,
      eq. 12 to 14.
    - `ransac`: the best of `hypotheses` motions from three matches each, drawn by `key`. With a share w of
      right matches it misses with a probability of (1 - w³)^hypotheses: 0.1 % at w = 0.3 and 256.

    From there optimistix' Levenberg-Marquardt minimises the sum of squares, under Tukey's kernel for the two
    robust methods. No number of matches makes a NaN. The motion is differentiable with respect to points and
    weights, by the implicit function theorem at that minimum.

    Args:
        source_points: p, metres; a row that is not finite is no match.
        target_points: q, metres.
        weights: at least 0, such as inverse variances; 1 if not given.
        valid: rows that are matches, all if not given.
        method: see above; static.
        max_distance: distance below which a match is an inlier, metres.
        min_inlier_fraction: least share of inliers among the matches for `converged`.
        hypotheses: number of hypotheses of `ransac`; static.
        key: random key, for `ransac` only.
        refined: False leaves out the last minimisation, and with it the derivatives. It takes most of the
            time, which a motion that is only a start does not need; static.

    Raises:
        InputError: the lists differ in length, or `ransac` has no key.
    """
    _check_rows(source_points, target_points, weights, valid)
    if method == "ransac" and key is None:
        raise InputError("RANSAC draws its hypotheses at random: give it a key, such as jax.random.key(0).")
    p, q = jnp.asarray(source_points), jnp.asarray(target_points)
    used = jnp.ones(p.shape[0], bool) if valid is None else jnp.asarray(valid)
    given = jnp.ones(p.shape[0], p.dtype) if weights is None else jnp.asarray(weights)
    rows = (padded(x) for x in (p, q, given, used))
    result = _rigid(
        *rows,
        key=jax.random.key(0) if key is None else key,
        max_distance=max_distance,
        min_inlier_fraction=min_inlier_fraction,
        method=method,
        hypotheses=hypotheses,
        refined=refined,
    )
    return eqx.tree_at(lambda r: r.inliers, result, result.inliers[: p.shape[0]])


def _check_rows(*lists: Array | np.ndarray | None) -> None:
    counts = {x.shape[0] for x in lists if x is not None}
    if len(counts) != 1:
        raise InputError(f"Matches have one row each in all lists, but these have {sorted(counts)} rows.")


@partial(jax.jit, static_argnames=("method", "hypotheses", "refined"))
@exact_products
def _rigid(
    p: Float[Array, "N 3"],
    q: Float[Array, "N 3"],
    weights: Float[Array, " N"],
    valid: Bool[Array, " N"],
    *,
    key: Key[Array, ""],
    max_distance: float | Array,
    min_inlier_fraction: float | Array,
    method: Method,
    hypotheses: int,
    refined: bool,
) -> RigidResult:
    matches, frames = _centred_matches(p, q, weights, valid)
    fixed = lax.stop_gradient(matches)
    limit = jnp.asarray(max_distance, p.dtype)
    match method:
        case "least_squares":
            T, _ = absolute_orientation(fixed.source, fixed.target, fixed.weights)
        case "graduated":
            T = _graduated_non_convexity(fixed, limit)
        case "ransac":
            T = _fit_inliers(fixed, _random_sample_consensus(fixed, limit, key, hypotheses), limit)
        case _:
            assert_never(method)
    if refined:
        T = _refined(matches, T, None if method == "least_squares" else limit)

    square = fixed.squares(lax.stop_gradient(T))
    inliers = fixed.used if method == "least_squares" else fixed.used & (square < limit**2)
    number = jnp.sum(inliers, dtype=jnp.int32)
    weight = jnp.where(inliers, 1, 0).astype(p.dtype)
    _, unique = absolute_orientation(fixed.source, fixed.target, weight)
    enough = jnp.sum(weight) >= jnp.maximum(
        3, jnp.asarray(min_inlier_fraction, p.dtype) * jnp.sum(fixed.used.astype(p.dtype))
    )
    return RigidResult(
        T_target_source=frames.uncentred(T),
        inliers=inliers,
        num_inliers=number,
        rmse=jnp.sqrt(weight @ square / jnp.maximum(jnp.sum(weight), 1)),
        unique=unique,
        converged=unique & enough,
    )


class _Matches(eqx.Module):
    """Matched points, centred: source and target (N, 3), weights (N,) and mask (N,)."""

    source: Float[Array, "N 3"]
    target: Float[Array, "N 3"]
    weights: Float[Array, " N"]
    used: Bool[Array, " N"]

    def squares(self, T: jaxlie.SE3) -> Float[Array, " N"]:
        """Squared distances between the moved sources and their targets."""
        return jnp.sum((se3.transform(T, self.source) - self.target) ** 2, axis=1)


def _centred_matches(
    p: Float[Array, "N 3"], q: Float[Array, "N 3"], weights: Float[Array, " N"], valid: Bool[Array, " N"]
) -> tuple[_Matches, CentredFrames]:
    """Usable matches around their means, where float32 holds their coordinates well; others are 0."""
    used = valid & jnp.all(jnp.isfinite(p) & jnp.isfinite(q), axis=1) & jnp.isfinite(weights) & (weights > 0)
    p, q = jnp.where(used[:, None], p, 0), jnp.where(used[:, None], q, 0)
    weights = jnp.where(used, weights, 0)
    share = used.astype(p.dtype) / jnp.maximum(jnp.sum(used), 1).astype(p.dtype)
    frames = CentredFrames(lax.stop_gradient(share @ p), lax.stop_gradient(share @ q))
    matches = _Matches(
        jnp.where(used[:, None], p - frames.source[None], 0),
        jnp.where(used[:, None], q - frames.target[None], 0),
        weights,
        used,
    )
    return matches, frames


def _fit_inliers(matches: _Matches, T: jaxlie.SE3, limit: Float[Array, ""]) -> jaxlie.SE3:
    """Least squares over the inliers of a motion."""
    inliers = matches.squares(T) < limit**2
    return absolute_orientation(matches.source, matches.target, jnp.where(inliers, matches.weights, 0))[0]


class _Graduation(eqx.Module):
    """State of graduated non-convexity: the motion, the weights it is made with, the next control value."""

    T: jaxlie.SE3
    robust: Float[Array, " N"]
    control: Float[Array, ""]
    step: Int[Array, ""]
    converged: Bool[Array, ""]


def _graduated_non_convexity(matches: _Matches, limit: Float[Array, ""]) -> jaxlie.SE3:
    start, _ = absolute_orientation(matches.source, matches.target, matches.weights)
    largest = jnp.max(jnp.where(matches.used, matches.squares(start), 0))
    # Below this the surrogate of the cost is convex; nothing is to be graduated if all are inliers already.
    first = limit**2 / jnp.maximum(2 * largest - limit**2, 1e-6 * limit**2)

    def unfinished(state: _Graduation) -> Bool[Array, ""]:
        return (state.step < _GRADUATION_STEPS) & ~state.converged

    def step(state: _Graduation) -> _Graduation:
        square, control = matches.squares(state.T), state.control
        low, high = control / (control + 1) * limit**2, (control + 1) / control * limit**2
        between = limit * jnp.sqrt(control * (control + 1) / jnp.maximum(square, low)) - control
        robust = jnp.where(square <= low, 1, jnp.where(square >= high, 0, between))
        T, _ = absolute_orientation(matches.source, matches.target, matches.weights * robust)
        # The band between low and high only narrows. Once no match is in it, further steps change nothing.
        converged = jnp.all((robust == state.robust) & ((square <= low) | (square >= high)))
        control = jnp.minimum(control * _GRADUATION_FACTOR, 1e6)
        return _Graduation(T, robust, control, state.step + 1, converged)

    begin = _Graduation(start, jnp.ones_like(matches.weights), first, jnp.asarray(0), jnp.asarray(False))
    return lax.while_loop(unfinished, step, begin).T


def _random_sample_consensus(
    matches: _Matches, limit: Float[Array, ""], key: Key[Array, ""], hypotheses: int
) -> jaxlie.SE3:
    """Motion with the least sum of truncated squares, among those of three matches drawn at random."""
    triples = _random_triples(matches.used, key, hypotheses)
    one = jnp.ones(3, matches.source.dtype)
    motions, unique = jax.vmap(lambda p, q: absolute_orientation(p, q, one))(
        matches.source[triples], matches.target[triples]
    )
    costs = jax.vmap(lambda T: matches.weights @ jnp.minimum(matches.squares(T), limit**2))(motions)
    best = jnp.argmin(jnp.where(unique, costs, jnp.inf))
    return jax.tree.map(lambda x: x[best], motions)


def _random_triples(used: Bool[Array, " N"], key: Key[Array, ""], number: int) -> Int[Array, "H 3"]:
    """Triples of different matches, if there are three."""
    count = jnp.sum(used, dtype=jnp.int32)
    left = jnp.maximum(count - jnp.arange(3, dtype=jnp.int32), 1)
    shares = jax.random.uniform(key, (number, 3)) * left.astype(jnp.float32)[None]
    a, b, c = jnp.minimum(jnp.floor(shares).astype(jnp.int32), left[None] - 1).T
    # The second is drawn from the matches left by the first, the third from those left by both.
    b = jnp.where(b >= a, b + 1, b)
    low, high = jnp.minimum(a, b), jnp.maximum(a, b)
    c = jnp.where(c >= low, c + 1, c)
    c = jnp.where(c >= high, c + 1, c)
    places = jnp.argsort(~used, stable=True)
    return places[jnp.minimum(jnp.stack([a, b, c], axis=1), used.shape[0] - 1)]


def _refined(matches: _Matches, T: jaxlie.SE3, limit: Float[Array, ""] | None) -> jaxlie.SE3:
    """Nearby minimum of the weighted squares, or of Tukey's kernel of them, with its derivatives."""

    def residuals(
        delta: Float[Array, "6"], args: tuple[_Matches, jaxlie.SE3, Float[Array, ""] | None]
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
        # A weak pull to the start holds the directions that no match fixes.
        anchor = 1e-3 * jnp.sqrt(jnp.maximum(jnp.sum(matches.weights), 1e-6))
        return root[:, None] * offsets, lax.stop_gradient(anchor) * delta

    # The derivatives are those of the minimum, so the steps go on until rounding ends them.
    tolerance = 10 * float(jnp.finfo(matches.source.dtype).eps)
    solution = optimistix.least_squares(
        residuals,
        optimistix.LevenbergMarquardt(rtol=tolerance, atol=tolerance),
        jnp.zeros(6, matches.source.dtype),
        (matches, lax.stop_gradient(T), limit),
        max_steps=_REFINEMENT_STEPS,
        throw=False,
    )
    return se3.compose(lax.stop_gradient(T), se3.exp(solution.value))
