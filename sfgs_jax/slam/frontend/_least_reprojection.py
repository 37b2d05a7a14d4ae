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
from sfgs_jax.geometry import kernel_weight, reprojection_residuals, se3
from sfgs_jax.sensors import carried, row_places
from sfgs_jax.slam.state._tracker import TrackerParams

_LEAST = 1e-3
"""Information that keeps a motion in place which no match fixes, 1 / m² and 1 / rad²."""


class MatchedRows(NamedTuple):
    """Matched keypoints: the target's points, what the source saw of them, and weights, None if equal."""

    points: Float[Array, "k 3"]
    pixels: Float[Array, "k 2"]
    depth: Float[Array, " k"]
    valid: Bool[Array, " k"]
    sweep: gicp.Sweep | None
    weights: Float[Array, " k"] | None = None


def row_residuals(
    T: jaxlie.SE3, rows: MatchedRows, params: TrackerParams
) -> tuple[Float[Array, "3 k"], Float[Array, "3 6 k"], Bool[Array, " k"]]:
    """Whitened residuals of T_target_source, their Jacobians in its tangent, and which rows have an image."""
    # Rows that are not valid may hold anything: they go to where nothing has an image.
    points = jnp.where(rows.valid, se3.transform(se3.inverse(T), rows.points).T, 0)
    if rows.sweep is not None:
        moving = rows.sweep.at(T)
        times = moving.timing.colour_times(row_places(rows.pixels[:, 1], params.camera.height))
        # The Jacobian leaves out that the twist turns with T: it says where to step, not where to end.
        points = carried(points, moving.twist, -times)
    found = reprojection_residuals(
        params.camera,
        points,
        rows.pixels.T,
        rows.depth,
        sigma=params.noise.pixels,
        inverse_depth_sigma=params.noise.inverse_depth,
    )
    return found.residual, found.pose_jacobian, found.has_image


class _Equations(NamedTuple):
    """Normal equations of the matches, and the weighted sums of their squares and of their weights."""

    hessian: Float[Array, "6 6"]
    gradient: Float[Array, "6"]
    square: Float[Array, ""]
    weight: Float[Array, ""]


def _equations(T: jaxlie.SE3, rows: MatchedRows, params: TrackerParams) -> _Equations:
    """Iteratively reweighted normal equations at a motion."""
    residual, jacobian, front = row_residuals(T, rows, params)
    square, width = jnp.sum(residual**2, axis=0), params.config.features.kernel_width
    weight = jnp.where(front, kernel_weight(square, "geman_mcclure", width), 0)
    weight = weight if rows.weights is None else weight * rows.weights
    rows_of = jnp.moveaxis(jacobian, 1, 0).reshape(6, -1)
    weighted = jnp.moveaxis(weight[None, None] * jacobian, 1, 0).reshape(6, -1)
    hessian = jnp.matmul(weighted, rows_of.T, precision=Precision.HIGHEST)
    gradient = jnp.matmul(weighted, residual.reshape(-1), precision=Precision.HIGHEST)
    return _Equations(hessian, gradient, jnp.sum(weight * square), jnp.sum(weight))


class _Descent(NamedTuple):
    """A motion after so many steps, and the length of the last one."""

    T: jaxlie.SE3
    steps: Int[Array, ""]
    length: Float[Array, ""]


@eqx.filter_custom_jvp
def least_reprojection(start: jaxlie.SE3, rows: MatchedRows, params: TrackerParams) -> jaxlie.SE3:
    """Motion after Gauss-Newton steps from a start, until they are short."""
    config = params.config.features

    def unfinished(state: _Descent) -> Bool[Array, ""]:
        return (state.steps < config.max_iterations) & (state.length > config.tolerance)

    def step(state: _Descent) -> _Descent:
        hessian, gradient, _, _ = _equations(state.T, rows, params)
        # Damped by its own diagonal, so that what no match fixes stays where it is.
        damped = hessian + jnp.diag(1e-4 * jnp.diagonal(hessian) + _LEAST)
        delta = -gauss_jordan(jnp.concatenate([damped, gradient[:, None]], axis=1))[1][:, 0]
        T = se3.compose(state.T, se3.exp(jnp.clip(delta, -0.5, 0.5)))
        return _Descent(T, state.steps + 1, jnp.max(jnp.abs(delta)))

    far = jnp.full((), jnp.inf, rows.depth.dtype)
    return lax.while_loop(unfinished, step, _Descent(start, jnp.asarray(0), far)).T


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
