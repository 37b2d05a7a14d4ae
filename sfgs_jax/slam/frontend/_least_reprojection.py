"""The motion with the least reprojection error of matched keypoints, and its derivative."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
from jax import lax
from jax.lax import Precision
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax import gicp
from sfgs_jax.arrays import gauss_jordan
from sfgs_jax.geometry import ReprojectionResiduals, kernel_rho, kernel_weight, reprojection_residuals, se3
from sfgs_jax.sensors import carried, row_places
from sfgs_jax.slam.frontend._target_noise import target_noise, with_target_noise
from sfgs_jax.slam.state._tracker import TrackerParams

_RISE = 1e-3
"""Share of the cost by which a step may raise it. The Jacobian leaves out that the twist of a frame's rows
turns with its motion, so its zero lies a little beside the least cost."""
_LEAST = 1e-3
"""Information that keeps a motion in place which no match fixes, 1 / m² and 1 / rad²."""


class MatchedRows(NamedTuple):
    """Matched keypoints: the target's points, what the source saw of them, and weights, None if equal.

    The pixels have the standard deviation `sigma`, and the matches a Geman-McClure kernel of `width` standard
    deviations.
    """

    points: Float[Array, "k 3"]
    pixels: Float[Array, "k 2"]
    depth: Float[Array, " k"]
    valid: Bool[Array, " k"]
    sigma: Float[Array, ""]
    width: float
    sweep: gicp.Sweep | None
    weights: Float[Array, " k"] | None = None


def row_residuals(T: jaxlie.SE3, rows: MatchedRows, params: TrackerParams) -> ReprojectionResiduals:
    """Residuals of T_target_source and their derivatives, in standard deviations of what the source measures.

    Args:
        T: the motion.
        rows: the matches.
        params: parameters of tracking.
    """
    # Rows that are not valid may hold anything: they go to where nothing has an image.
    points = jnp.where(rows.valid, se3.transform(se3.inverse(T), rows.points).T, 0)
    if rows.sweep is not None:
        moving = rows.sweep.at(T)
        times = moving.timing.colour_times(row_places(rows.pixels[:, 1], params.camera.height))
        # The Jacobian leaves out that the twist turns with T: it says where to step, not where to end.
        points = carried(points, moving.twist, -times)
    return reprojection_residuals(
        params.camera,
        points,
        rows.pixels.T,
        rows.depth,
        sigma=rows.sigma,
        inverse_depth_sigma=params.noise.inverse_depth,
    )


class _Equations(NamedTuple):
    """Cost of a motion, and its derivatives.

    Attributes:
        cost: half the robust squares of the matches, summed.
        gradient: of the cost.
        hessian: with the weights of the matches held fixed.
        bend: what their fall takes off the Hessian.
        square: weighted sum of the squares.
        weight: sum of the weights.
    """

    cost: Float[Array, ""]
    gradient: Float[Array, "6"]
    hessian: Float[Array, "6 6"]
    bend: Float[Array, "6 6"]
    square: Float[Array, ""]
    weight: Float[Array, ""]


def _equations(T: jaxlie.SE3, rows: MatchedRows, params: TrackerParams) -> _Equations:
    """Cost and derivatives at a motion.

    Source: Triggs et al., Bundle Adjustment, a Modern Synthesis (2000), section 4.3.
    """
    at = row_residuals(T, rows, params)
    points = jnp.where(rows.valid[:, None], rows.points, 0)
    at = with_target_noise(at, target_noise(T, points, at, params.noise.inverse_depth))
    residual, jacobian = at.residual, at.pose_jacobian
    square, width = jnp.sum(residual**2, axis=0), rows.width
    weight = jnp.where(at.has_image, kernel_weight(square, "geman_mcclure", width), 0)
    weight = weight if rows.weights is None else weight * rows.weights
    rows_of = jnp.moveaxis(jacobian, 1, 0).reshape(6, -1)
    weighted = jnp.moveaxis(weight[None, None] * jacobian, 1, 0).reshape(6, -1)
    hessian = jnp.matmul(weighted, rows_of.T, precision=Precision.HIGHEST)
    gradient = jnp.matmul(weighted, residual.reshape(-1), precision=Precision.HIGHEST)
    fall = weight * 4 / (width**2 + square)
    pulls = jnp.sum(jacobian * residual[:, None], axis=0)
    bend = jnp.matmul(fall[None] * pulls, pulls.T, precision=Precision.HIGHEST)
    cost = jnp.where(rows.valid, kernel_rho(square, "geman_mcclure", width) / 2, 0)
    cost = jnp.sum(cost if rows.weights is None else cost * rows.weights)
    return _Equations(cost, gradient, hessian, bend, jnp.sum(weight * square), jnp.sum(weight))


class _Descent(NamedTuple):
    """State of the search for the least cost.

    Attributes:
        T: the motion to try next.
        least: the motion with the least cost so far.
        cost: its cost.
        sure: step from there with the weights held fixed; half of it, and so on, if it raised the cost.
        steps: taken so far.
        length: of the last one.
    """

    T: jaxlie.SE3
    least: jaxlie.SE3
    cost: Float[Array, ""]
    sure: Float[Array, "6"]
    steps: Int[Array, ""]
    length: Float[Array, ""]


@eqx.filter_custom_jvp
def least_reprojection(start: jaxlie.SE3, rows: MatchedRows, params: TrackerParams) -> jaxlie.SE3:
    """Motion with the least robust reprojection error, from a start.

    Steps are Newton's where these lower the cost, elsewhere those of reweighted least squares. The latter
    alone are three times as many, because matches at the kernel's shoulder hold them back.
    """
    config = params.config.features

    def unfinished(state: _Descent) -> Bool[Array, ""]:
        return (state.steps < config.max_iterations) & (state.length > config.tolerance)

    def step(state: _Descent) -> _Descent:
        at = _equations(state.T, rows, params)
        sure, newton = _step(at.hessian, at.gradient), _step(at.hessian - at.bend, at.gradient)
        bold = jnp.where(jnp.sum(newton * at.gradient) < 0, newton, sure)
        lower = at.cost <= (1 + _RISE) * state.cost
        least, cost, sure, delta = (
            jnp.where(lower, a, b)
            for a, b in (
                (state.T.wxyz_xyz, state.least.wxyz_xyz),
                (at.cost, state.cost),
                (sure, state.sure / 2),
                (bold, state.sure),
            )
        )
        T = se3.compose(jaxlie.SE3(least), se3.exp(delta))
        return _Descent(T, jaxlie.SE3(least), cost, sure, state.steps + 1, jnp.max(jnp.abs(delta)))

    far, still = jnp.full((), jnp.inf, rows.depth.dtype), jnp.zeros(6, rows.depth.dtype)
    return lax.while_loop(unfinished, step, _Descent(start, start, far, still, jnp.asarray(0), far)).T


def _step(hessian: Float[Array, "6 6"], gradient: Float[Array, "6"]) -> Float[Array, "6"]:
    """A step, damped by its own diagonal, so that what no match fixes stays where it is."""
    damped = hessian + jnp.diag(1e-4 * jnp.abs(jnp.diagonal(hessian)) + _LEAST)
    delta = -gauss_jordan(jnp.concatenate([damped, gradient[:, None]], axis=1))[1][:, 0]
    return jnp.clip(delta, -0.5, 0.5)


@least_reprojection.def_jvp
def _least_reprojection_jvp(primals: tuple, tangents: tuple) -> tuple[jaxlie.SE3, Any]:
    """The minimum does not move with the start, and with all else like one Newton step."""
    (start, *others), (_, *rates) = primals, tangents
    T = least_reprojection(start, *others)
    _, rate = eqx.filter_jvp(lambda *moving: newton_corrected(T, *moving), others, rates)
    return T, rate


def newton_corrected(T: jaxlie.SE3, rows: MatchedRows, params: TrackerParams) -> jaxlie.SE3:
    """Motion after one Newton step from a minimum, whose derivative is the minimum's.

    There the gradient g of the matches' weighted squares is 0. So the motion moves with anything else by
    -(dg/dT)^-1 dg.
    """
    T, fixed_rows, fixed_params = lax.stop_gradient((T, rows, params))

    def gradient_at(delta: Float[Array, "6"]) -> Float[Array, "6"]:
        return _equations(se3.compose(T, se3.exp(delta)), fixed_rows, fixed_params).gradient

    hessian = jax.jacfwd(gradient_at)(jnp.zeros(6, rows.depth.dtype))
    # A little keeps a motion in place that no match fixes.
    regular = hessian + _LEAST * jnp.eye(6, dtype=hessian.dtype)
    delta = -jnp.linalg.solve(regular, _equations(T, rows, params).gradient)
    return se3.compose(T, se3.exp(delta))


def information(T: jaxlie.SE3, rows: MatchedRows, params: TrackerParams) -> Float[Array, "6 6"]:
    """The Hessian of a motion, divided by the excess of the residuals and by the matches' correlation."""
    equations = _equations(T, rows, params)
    # Three rows a match.
    excess = jnp.maximum(equations.square / jnp.maximum(3 * equations.weight, 1), 1)
    return equations.hessian / excess / params.config.features.correlation
