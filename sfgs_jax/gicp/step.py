"""One step of an alignment: normal equations at a motion, and their solution."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
from jax import lax
from jaxtyping import Array, Float

from sfgs_jax.geometry import kernel_rho, kernel_weight
from sfgs_jax.gicp.config import GicpConfig
from sfgs_jax.gicp.correspondences import Correspondences, Samples, dot
from sfgs_jax.gicp.normal_equations import (
    gradient,
    hessian,
    isotropic_hessian,
    moment_sums,
    pulls,
    squared_radius,
    total,
)
from sfgs_jax.gicp.prior import MotionPrior, prior_equations
from sfgs_jax.gicp.residuals import shape_weights, weight_matrices


class Equations(eqx.Module):
    """Normal equations of an alignment.

    Attributes:
        hessian: (6, 6) of half the weighted squares of the residuals.
        gradient: (6,).
        fixing: (6, 6) the part of the Hessian by which the geometry fixes the motion.
        prior: Hessian and gradient of a prior; None without one.
        unit: (6,) what to measure the tangent's entries in.
        weight: total weight of the correspondences.
        cost: mean robust cost of a source point, those without a correspondence at a fixed cost.
    """

    hessian: Float[Array, "6 6"]
    gradient: Float[Array, "6"]
    fixing: Float[Array, "6 6"]
    prior: tuple[Float[Array, "6 6"], Float[Array, "6"]] | None
    unit: Float[Array, "6"]
    weight: Float[Array, ""]
    cost: Float[Array, ""]


def normal_distance(source: Samples, pairs: Correspondences) -> Float[Array, " N"]:
    """Distance along the mean of the two normals, metres: what the residual is judged by."""
    mean = source.normals + pairs.normals
    along = dot(source.points - pairs.points, mean)
    return along * lax.rsqrt(jnp.where(pairs.found, dot(mean, mean), 1))


def directions(source: Samples, pairs: Correspondences, config: GicpConfig) -> Float[Array, "6 N"]:
    """Weights of the residual's directions, 1 along the normal."""
    if config.residual == "gicp" and pairs.shapes is not None:
        return shape_weights(source.normals, pairs.shapes, epsilon=config.epsilon)
    return weight_matrices(source.normals, pairs.normals, residual=config.residual, epsilon=config.epsilon)


def confidence(
    source: Samples, pairs: Correspondences, width: float, config: GicpConfig
) -> Float[Array, " N"]:
    """Inverse variance times robust weight; 0 without a correspondence."""
    square = normal_distance(source, pairs) ** 2 / pairs.variance
    return jnp.where(pairs.found, kernel_weight(square, config.kernel, width) / pairs.variance, 0)


def equations(
    source: Samples,
    pairs: Correspondences,
    moments: Float[Array, "10 N"],
    T: jaxlie.SE3,
    prior: MotionPrior | None,
    width: float,
    shared: float,
    config: GicpConfig,
) -> Equations:
    """Normal equations at a motion with its correspondences; `width` is the robust kernel's.

    `shared` is how many source points share one measurement, which the prior is weighed up by.
    """
    confident = confidence(source, pairs, width, config)
    weights = directions(source, pairs, config) * confident
    sums, pulled, isotropic = moment_sums(
        moments, weights, pulls(weights, source.points - pairs.points), confident
    )
    fixing = full = hessian(sums)
    if config.residual == "gicp":
        # What GICP weighs all directions by only keeps correspondences together: it fixes no motion.
        fixing = full - config.epsilon * isotropic_hessian(isotropic)

    square = jnp.where(pairs.found, normal_distance(source, pairs) ** 2 / pairs.variance, 0)
    lost = jnp.full_like(square[:1], (config.inlier_width * width) ** 2)
    rho = kernel_rho(jnp.where(pairs.found, square, lost), config.kernel, width)
    usable = source.valid.astype(square.dtype)
    cost = jnp.sum(usable * rho) / 2 / shared
    held = None
    if prior is not None:
        prior_hessian, prior_gradient, prior_cost = prior_equations(prior, T)
        held, cost = (shared * prior_hessian, shared * prior_gradient), cost + prior_cost
    return Equations(full, gradient(pulled), fixing, held, _units(isotropic), total(isotropic), cost)


def _units(sums: Float[Array, "10"]) -> Float[Array, "6"]:
    """Steps of about equal effect: a metre, and the rotation that moves points at the mean radius by one."""
    square = squared_radius(sums, least=1e-6)
    return jnp.where(jnp.arange(6) < 3, 1, lax.rsqrt(jnp.maximum(square, 1e-6)))


def solve(e: Equations, damping: Float[Array, ""], floor: float) -> Float[Array, "6"]:
    """Damped step. Along directions that the geometry leaves free only a prior moves it.

    Source: solution remapping, Zhang, Kaess and Singh, On degeneracy of optimization-based state estimation
    problems (ICRA 2016); here the equations are restricted before they are solved.

    Args:
        e: normal equations.
        damping: share of the diagonal added to it.
        floor: least observability of a direction that is not free.
    """
    hessian, gradient = _restricted(e, floor)
    # Columns are scaled first, for float32.
    scale = lax.rsqrt(jnp.diagonal(hessian))
    damped = hessian * scale[:, None] * scale[None, :] + damping * jnp.eye(6, dtype=scale.dtype)
    return -e.unit * scale * jax.scipy.linalg.solve(damped, scale * gradient, assume_a="pos")


def newton(e: Equations, floor: float) -> Float[Array, "6"]:
    """The same without damping, for Hessians that need not be symmetric nor positive."""
    return -e.unit * jnp.linalg.solve(*_restricted(e, floor))


def _restricted(e: Equations, floor: float) -> tuple[Float[Array, "6 6"], Float[Array, "6"]]:
    """Regular Hessian and gradient in the tangent's units, without the geometry along what it leaves free."""
    outer = lax.stop_gradient(e.unit[:, None] * e.unit[None, :])
    values, vectors = jnp.linalg.eigh(lax.stop_gradient(e.fixing * outer))
    fixed = jnp.where(values > floor * jnp.maximum(e.weight, 1e-6), vectors, 0)
    keep = fixed @ fixed.T
    hessian, gradient = keep @ (e.hessian * outer) @ keep, keep @ (e.unit * e.gradient)
    size, share = jnp.trace(hessian), 1.0
    if e.prior is not None:
        known = e.prior[0] * outer
        hessian, gradient = hessian + known, gradient + e.prior[1] * e.unit
        # Enough to be regular where the prior says nothing, and too little to hold it up where it does. A
        # prior without any information is none: so little would let rounding run off along what is free.
        size = jnp.trace(hessian)
        share = jnp.where(jnp.trace(known) > 1e-6 * size, 1e-6, 1.0)
    rest = jnp.eye(6, dtype=e.unit.dtype) - keep
    return hessian + share * jnp.where(size > 0, size, 1) * rest, gradient
