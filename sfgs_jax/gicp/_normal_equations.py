"""Normal equations of a rigid alignment: residual weights, sums over the points, priors, and the solution.

A source point p that meets q has the residual r = exp(delta) p - q in source coordinates, with a weight
matrix W. The cost is half the sum of r^T W r. The Jacobian of r, J = [I, -[p]x], is linear in (p, 1) and
depends on the source point alone. So both sides of the equations are linear in sums of W and W r times the
point's moments. These are the products of two entries of (p, 1), and stay the same through an alignment.
"""

from functools import partial
from typing import assert_never

import equinox as eqx
import jax.numpy as jnp
import jaxlie
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from sfgs_jax.arrays import (
    INDICES,
    SQUARE,
    Symmetric,
    checked,
    dot,
    gauss_jordan,
    identity_like,
    outer,
    symmetric_inverse,
)
from sfgs_jax.geometry import inverse_right_jacobian, se3
from sfgs_jax.gicp._config import Residual
from sfgs_jax.gicp._exact_products import exact_products

_LEAST_WEIGHT = 1e-6
"""Bound below the total weight that sums are divided by, so that no correspondences make no NaN."""


def _jacobian_tensor() -> np.ndarray:
    """E of J[a, m] = E[a, m, k] (p, 1)[k]: the Jacobian [I, -[p]x] of exp(delta) p at delta = 0."""
    tensor = np.zeros((3, 6, 4))
    tensor[range(3), range(3), 3] = 1
    for a, b, c in [(0, 1, 2), (1, 2, 0), (2, 0, 1)]:
        tensor[a, 3 + b, c], tensor[a, 3 + c, b] = 1, -1
    return tensor


_JACOBIAN = _jacobian_tensor()
# Place of each entry of a symmetric 4 x 4 matrix in the list of its upper triangle.
_PAIRS = np.triu_indices(4)
_PAIR_INDEX = np.zeros((4, 4), np.int32)
_PAIR_INDEX[_PAIRS] = _PAIR_INDEX[_PAIRS[::-1]] = range(10)


def _as_mean(T_target_source: se3.Pose) -> jaxlie.SE3:
    return se3.as_se3(T_target_source, name="The mean of a MotionPrior", axes=None)


class MotionPrior(eqx.Module):
    """Gaussian prior of a motion: T = mean exp(x) with x of zero mean.

    Attributes:
        T_target_source: mean; a homogeneous 4 x 4 matrix becomes a `jaxlie.SE3`.
        information: (6, 6) inverse covariance of x (translation first), metres and radians.
    """

    T_target_source: jaxlie.SE3 = eqx.field(converter=_as_mean)
    information: Float[Array, "6 6"]


class NormalEquations(eqx.Module):
    """Normal equations of an alignment in the tangent at a motion (translation first, metres and radians).

    Attributes:
        hessian: (6, 6) of half the weighted squares of the residuals.
        gradient: (6,) of the same.
        geometric_hessian: (6, 6) part of the Hessian that observes the motion. It leaves out the weight that
            the `gicp` residual gives all directions alike.
        prior: Hessian and gradient of a prior; None without one.
        scale: (6,) unit of each tangent entry: a metre, and the rotation that moves points at the mean radius
            by a metre.
        weight: total weight of the correspondences.
        cost: mean robust cost of a source point, with a fixed cost for those without a correspondence, plus
            the prior's.
    """

    hessian: Float[Array, "6 6"]
    gradient: Float[Array, "6"]
    geometric_hessian: Float[Array, "6 6"]
    prior: tuple[Float[Array, "6 6"], Float[Array, "6"]] | None
    scale: Float[Array, "6"]
    weight: Float[Array, ""]
    cost: Float[Array, ""]


@checked
def weight_matrices(
    source_normals: Float[Array, "3 N"],
    target_normals: Float[Array, "3 N"],
    *,
    residual: Residual,
    epsilon: float,
) -> Float[Array, "6 N"]:
    """Weight matrix of each residual vector p - q; about 1 along the normal.

    The residual `point_to_point` weighs all directions alike, `point_to_plane` only the target's normal. The
    residual `gicp` is plane to plane: it weighs by the inverse of the sum of both points' covariances. Each
    covariance is `epsilon` along the point's normal and 1 within its plane. A factor of 2 epsilon makes the
    variance along the normal the unit.

    With k = 1 - epsilon and unit normals s and t, the sum is 2 I - k (s s^T + t t^T). Its eigenvectors are
    s + t and s - t, so the inverse has a closed form. Source: Segal, Haehnel and Thrun, Generalized-ICP (RSS
    2009), eq. 2 and section III-B.

    Args:
        source_normals: unit normals s.
        target_normals: unit normals t.
        residual: which residual.
        epsilon: variance along a normal, as a share of that within the plane.

    Returns:
        Upper triangles xx xy xz yy yz zz.
    """
    s, t = source_normals, target_normals
    match residual:
        case "point_to_point":
            return identity_like(s[0])
        case "point_to_plane":
            return outer(t)
        case "gicp":
            k, cosine = 1 - epsilon, dot(s, t)
            along = epsilon * k / (4 - 2 * k * (1 + cosine))
            across = epsilon * k / (4 - 2 * k * (1 - cosine))
            mean, difference = s + t, s - t
            return jnp.stack(
                [
                    epsilon * (i == j) + along * mean[i] * mean[j] + across * difference[i] * difference[j]
                    for i, j in INDICES
                ]
            )
        case _:
            assert_never(residual)


def covariance_weight_matrices(
    source_normals: Float[Array, "3 N"], target_covariances: Symmetric, *, epsilon: float
) -> Float[Array, "6 N"]:
    """`gicp` weight matrices for given target covariances, whose largest variance is 1."""
    s, keep = source_normals, 1 - epsilon
    source = jnp.stack([float(i == j) - keep * s[i] * s[j] for i, j in INDICES])
    inverse, _ = symmetric_inverse(source + target_covariances)
    return 2 * epsilon * inverse


def weighted_residuals(weights: Float[Array, "6 N"], residuals: Float[Array, "3 N"]) -> Float[Array, "3 N"]:
    """W r of each point, with W as upper triangles xx xy xz yy yz zz."""
    return jnp.stack([sum(weights[SQUARE[a, b]] * residuals[b] for b in range(3)) for a in range(3)])


def point_moments(points: Float[Array, "3 N"]) -> Float[Array, "10 N"]:
    """Products of two entries of (p, 1) for each point p, as upper triangles."""
    h = jnp.concatenate([points, jnp.ones_like(points[:1])])
    return jnp.concatenate([h[i : i + 1] * h[i:] for i in range(4)])


@exact_products
def moment_sums(
    moments: Float[Array, "10 N"], *weights: Float[Array, "... N"]
) -> list[Float[Array, "... 10"]]:
    """Sums over the points of their moments times weights, for several kinds of weights at once.

    One matrix product makes all sums of a step: XLA adds up a row by itself one number at a time.

    Args:
        moments: `point_moments` of the source points.
        weights: rows of them, each (K, N) or (N,).
    """
    rows = [jnp.atleast_2d(w) for w in weights]
    ends = np.cumsum([len(r) for r in rows])[:-1]
    sums = jnp.split(jnp.concatenate(rows) @ moments.T, ends)
    return [s if w.ndim == 2 else s[0] for s, w in zip(sums, weights, strict=True)]


def hessian(sums: Float[Array, "6 10"]) -> Float[Array, "6 6"]:
    """Sum of J^T W J, from the `moment_sums` of W."""
    return _hessian(sums[SQUARE])


def isotropic_hessian(sums: Float[Array, "10"]) -> Float[Array, "6 6"]:
    """Sum of w J^T J, from the `moment_sums` of a weight w that is the same in all directions."""
    return _hessian(jnp.eye(3, dtype=sums.dtype)[:, :, None] * sums[None, None])


@exact_products
def _hessian(sums: Float[Array, "3 3 10"]) -> Float[Array, "6 6"]:
    jacobian = jnp.asarray(_JACOBIAN, sums.dtype)
    return jnp.einsum("amk,bnl,abkl->mn", jacobian, jacobian, sums[:, :, _PAIR_INDEX])


@exact_products
def gradient(sums: Float[Array, "3 10"]) -> Float[Array, "6"]:
    """Sum of J^T W r, from the `moment_sums` of W r."""
    first = sums[:, _PAIR_INDEX[:, 3]]
    return jnp.einsum("amk,ak->m", jnp.asarray(_JACOBIAN, sums.dtype), first)


def total(sums: Float[Array, "10"]) -> Float[Array, ""]:
    """Sum of a weight itself, from its `moment_sums`."""
    return sums[_PAIR_INDEX[3, 3]]


def squared_radius(sums: Float[Array, "10"]) -> Float[Array, ""]:
    """Weighted mean of the points' squared distances from the origin, from a weight's `moment_sums`."""
    return jnp.sum(sums[np.diagonal(_PAIR_INDEX)[:3]]) / jnp.maximum(total(sums), _LEAST_WEIGHT)


@exact_products
def prior_equations(
    prior: MotionPrior, T: jaxlie.SE3
) -> tuple[Float[Array, "6 6"], Float[Array, "6"], Float[Array, ""]]:
    """Hessian, gradient and value of half x^T Lambda x, x = log(mean^-1 T exp(delta)), at delta = 0."""
    x = se3.log(se3.compose(se3.inverse(prior.T_target_source), T))
    rows = jnp.concatenate([inverse_right_jacobian(x[:, None])[:, :, 0], x[:, None]], axis=1)
    products = rows.T @ prior.information @ rows
    return products[:6, :6], products[:6, 6], products[6, 6] / 2


def tangent_scale(sums: Float[Array, "10"]) -> Float[Array, "6"]:
    """Units of tangent entries with about equal effect, from the `moment_sums` of the total weight.

    A metre for translations; for rotations the angle that moves points at the mean radius by a metre.
    """
    square = squared_radius(sums)
    return jnp.where(jnp.arange(6) < 3, 1, lax.rsqrt(jnp.maximum(square, 1e-6)))


def damped_step(
    equations: NormalEquations, damping: Float[Array, ""], min_observability: float
) -> Float[Array, "6"]:
    """Levenberg step, -(H + damping diag(H))^-1 g. Only a prior moves it along free directions.

    Source: solution remapping, Zhang, Kaess and Singh, On degeneracy of optimization-based state estimation
    problems (ICRA 2016); here the equations are projected before they are solved.

    Args:
        equations: normal equations at the motion.
        damping: share of the diagonal that is added to it.
        min_observability: least observability of a direction that is not free.
    """
    hessian, gradient = _projected(equations, min_observability)
    # Columns are scaled first, for float32.
    scale = lax.rsqrt(jnp.diagonal(hessian))
    damped = hessian * scale[:, None] * scale[None, :] + damping * jnp.eye(6, dtype=scale.dtype)
    _, step = gauss_jordan(jnp.concatenate([damped, (scale * gradient)[:, None]], axis=1))
    return -equations.scale * scale * step[:, 0]


def newton_step(equations: NormalEquations, min_observability: float) -> Float[Array, "6"]:
    """The same without damping, for Hessians that need not be symmetric nor positive."""
    return -equations.scale * jnp.linalg.solve(*_projected(equations, min_observability))


def _projected(e: NormalEquations, min_observability: float) -> tuple[Float[Array, "6 6"], Float[Array, "6"]]:
    """Regular Hessian and gradient in the tangent's scale, with the geometry projected off free directions.

    A direction is free if its eigenvalue of the geometric Hessian, per total weight, is too small.
    """
    outer = lax.stop_gradient(e.scale[:, None] * e.scale[None, :])
    geometric = lax.stop_gradient(e.geometric_hessian * outer)
    least = min_observability * jnp.maximum(lax.stop_gradient(e.weight), _LEAST_WEIGHT)
    # Pivots tell as surely as eigenvalues that nothing is free, and cost a GPU one kernel for some fifty.
    pivots, _ = gauss_jordan(geometric - least * jnp.eye(6, dtype=geometric.dtype))
    hessian, gradient, free = lax.cond(
        jnp.all(pivots > 0),
        lambda hessian, gradient: (hessian, gradient, jnp.zeros_like(hessian)),
        partial(_off_free_directions, geometric, least),
        *(e.hessian * outer, e.scale * e.gradient),
    )
    size, share = jnp.trace(hessian), 1.0
    if e.prior is not None:
        prior_hessian = e.prior[0] * outer
        hessian, gradient = hessian + prior_hessian, gradient + e.prior[1] * e.scale
        # A little makes free directions regular if the prior leaves them free too, and holds none back that
        # the prior moves. A prior without any information is like none: so little would let rounding drift.
        size = jnp.trace(hessian)
        share = jnp.where(jnp.trace(prior_hessian) > 1e-6 * size, 1e-6, 1.0)
    return hessian + share * jnp.where(size > 0, size, 1) * free, gradient


@exact_products
def _off_free_directions(
    geometric: Float[Array, "6 6"],
    least: Float[Array, ""],
    hessian: Float[Array, "6 6"],
    gradient: Float[Array, "6"],
) -> tuple[Float[Array, "6 6"], Float[Array, "6"], Float[Array, "6 6"]]:
    """Hessian and gradient off the free directions, and the projector onto these."""
    values, vectors = jnp.linalg.eigh(geometric)
    observed = jnp.where(values > least, vectors, 0)
    projector = observed @ observed.T
    free = jnp.eye(6, dtype=projector.dtype) - projector
    return projector @ hessian @ projector, projector @ gradient, free
