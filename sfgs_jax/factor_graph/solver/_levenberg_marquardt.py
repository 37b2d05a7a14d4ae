"""Levenberg-Marquardt and Gauss-Newton, in one loop."""

from functools import partial
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.arrays import checked
from sfgs_jax.factor_graph._values import Values, retract
from sfgs_jax.factor_graph.problem._gauge import restore_gauge
from sfgs_jax.factor_graph.problem._graph import FactorGraph, check_values
from sfgs_jax.factor_graph.solver._config import SolverConfig
from sfgs_jax.factor_graph.solver._cost import Losses, all_losses, cost_drop, half_sum
from sfgs_jax.factor_graph.solver._normal_equations import build_normal_equations
from sfgs_jax.factor_graph.solver._solution import Solution, Statistics, Status
from sfgs_jax.factor_graph.solver._step import Step, compute_step

LONG_ENOUGH = 0.8
"""The line search tries a shorter step if the parabola is lowest at a smaller share of the step than this."""

LEAST_STEP = 0.1
"""Least share of the step to try."""

_RUNNING = -1
_T = TypeVar("_T")


class _State(eqx.Module):
    """State of the loop; `losses` are those at `values`, `growth` the next factor of the damping."""

    values: Values
    losses: Losses
    damping: Float[Array, ""]
    growth: Float[Array, ""]
    iteration: Int[Array, ""]
    status: Int[Array, ""]
    undetermined: Bool[Array, ""]
    statistics: Statistics


class _Trial(eqx.Module):
    """A tried share of a step, and the share to try next."""

    values: Values
    losses: Losses
    drop: Float[Array, ""]
    gain: Float[Array, ""]
    share: Float[Array, ""]


@checked
def solve(graph: FactorGraph, values: Values, config: SolverConfig | None = None) -> Solution:
    """Values that minimise half the sum of robust squared whitened residuals, near the given ones.

    Levenberg-Marquardt on the diagonal of the Hessian, with the damping of Nielsen, Damping parameter in
    Marquardt's method (1999), eq. 2.4. Robust kernels are solved by iteratively reweighted least squares.

    It may be called within `jax.jit`, with the graph as an argument, and within `jax.vmap`, over graphs of
    one shape. Build the graphs outside, and give each the capacities of the first: their shapes then stay
    the same. For gradients of the optimum use `solve_implicit`.

    Args:
        graph: factors and structure.
        values: poses and landmarks to start from.
        config: settings, `SolverConfig()` if not given; static under `jit`.

    Raises:
        InputError: numbers of poses or landmarks that don't match the graph's.
    """
    check_values(graph, values)
    return _solve(graph, values, SolverConfig() if config is None else config)


@partial(jax.jit, static_argnames="config")
def _solve(graph: FactorGraph, values: Values, config: SolverConfig) -> Solution:
    if graph.gauge_pose is not None and config.method == "levenberg_marquardt":
        free = jnp.asarray(graph.free_poses)
        floating = eqx.tree_at(
            lambda g: (g.free_poses, g.gauge_pose), graph, (free.at[graph.gauge_pose].set(True), None)
        )
        solution = _solve(floating, values, config)
        restored = restore_gauge(solution.values, values, graph.gauge_pose, free)
        return eqx.tree_at(lambda s: s.values, solution, restored)
    state = _initial_state(graph, values, config)
    iterate = partial(_iterate, graph, config)
    if config.unrolled:

        def step(state: _State, _: None) -> tuple[_State, None]:
            return _select(state.status == _RUNNING, iterate(state), state), None

        state, _ = lax.scan(step, state, None, length=config.max_iterations)
    else:
        state = lax.while_loop(
            lambda s: (s.status == _RUNNING) & (s.iteration < config.max_iterations), iterate, state
        )
    status = jnp.where(state.status == _RUNNING, Status.MAX_ITERATIONS.value, state.status)
    singular = state.undetermined & (status != Status.DIVERGED.value)
    return Solution(
        values=state.values,
        cost=half_sum(state.losses, values),
        iterations=state.iteration,
        status_code=jnp.where(singular, Status.SINGULAR.value, status),
        statistics=state.statistics,
    )


def _initial_state(graph: FactorGraph, values: Values, config: SolverConfig) -> _State:
    dtype = values.poses.wxyz_xyz.dtype
    empty = jnp.full(config.max_iterations, jnp.nan, dtype)
    never = jnp.zeros(config.max_iterations, bool)
    return _State(
        values=values,
        losses=tuple(jnp.zeros(len(factor.valid), dtype) for factor in graph.factors),
        damping=jnp.asarray(config.initial_damping if config.method == "levenberg_marquardt" else 0, dtype),
        growth=jnp.asarray(2, dtype),
        iteration=jnp.asarray(0),
        status=jnp.asarray(_RUNNING),
        undetermined=jnp.asarray(False),
        statistics=Statistics(cost=empty, damping=empty, gain=empty, step=empty, accepted=never),
    )


def _iterate(graph: FactorGraph, config: SolverConfig, state: _State) -> _State:
    """One step, taken or not, and the damping of the next one."""
    marquardt = config.method == "levenberg_marquardt"
    equations = build_normal_equations(graph, state.values)
    step = compute_step(graph, equations, state.damping, config)
    # The first iteration has no losses from a line search yet.
    begun = state.iteration > 0
    before = tuple(_select(begun, a, b) for a, b in zip(state.losses, equations.losses, strict=True))
    current = half_sum(before, state.values)
    trial = _line_search(graph, state.values, before, step, tries=2 if marquardt else 1)
    finite = step.finite & jnp.isfinite(trial.drop)
    small = step.expected <= config.cost_tolerance * current
    largest = jnp.maximum(
        jnp.max(jnp.abs(step.poses)), jnp.max(jnp.abs(step.landmarks), initial=jnp.zeros((), current.dtype))
    )
    done = step.finite & (small | (largest <= config.step_tolerance))
    better = finite & (trial.drop > 0)
    accepted = better if marquardt else finite
    damping, growth = _next_damping(state, trial.gain, accepted, config)

    if marquardt:
        failed = jnp.where(damping > config.max_damping, Status.DIVERGED.value, _RUNNING)
    else:
        unsolved = jnp.where(step.finite, Status.DIVERGED.value, Status.SINGULAR.value)
        failed = jnp.where(accepted, _RUNNING, unsolved)
    status = jnp.where(done, Status.CONVERGED.value, failed)
    i, old = state.iteration, state.statistics
    values, losses = _select(accepted, (trial.values, trial.losses), (state.values, before))
    return _State(
        values=values,
        losses=losses,
        damping=damping,
        growth=growth,
        iteration=i + 1,
        status=jnp.where(jnp.isfinite(current), status, Status.DIVERGED.value),
        undetermined=equations.undetermined if marquardt else equations.undetermined | step.deficient,
        statistics=Statistics(
            cost=old.cost.at[i].set(current),
            damping=old.damping.at[i].set(state.damping),
            gain=old.gain.at[i].set(trial.gain),
            step=old.step.at[i].set(largest),
            accepted=old.accepted.at[i].set(accepted),
        ),
    )


def _next_damping(
    state: _State, gain: Float[Array, ""], accepted: Bool[Array, ""], config: SolverConfig
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Damping and its growth after a step, by Nielsen's rule; Gauss-Newton keeps its own.

    The damping shrinks the more, the better the model was. It grows faster with every failure in a row.
    """
    growth = jnp.where(accepted, 2, 2 * state.growth).astype(state.growth.dtype)
    if config.method != "levenberg_marquardt":
        return state.damping, growth
    shrink = jnp.maximum(1 / 3, 1 - (2 * gain - 1) ** 3)
    lower = jnp.maximum(state.damping * shrink, config.min_damping)
    return jnp.where(accepted, lower, state.damping * state.growth), growth


def _line_search(graph: FactorGraph, values: Values, before: Losses, step: Step, *, tries: int) -> _Trial:
    """Line search by quadratic interpolation: the whole step, or a share of it if that is better.

    A step leads too far where the cost curves more than its model. The second try goes to the lowest point of
    a parabola: it has the cost at both ends of the first try, and the slope at its beginning.
    """
    zero = jnp.zeros((), step.slope.dtype)

    def evaluate(best: _Trial) -> _Trial:
        share = best.share
        moved = retract(values, share * step.poses, share * step.landmarks)
        losses = all_losses(graph, moved)
        drop = cost_drop(before, losses, values)
        expected = share * step.slope - share**2 * (step.slope - step.expected)
        beyond = step.slope - drop
        lowest = step.slope / (2 * jnp.where(beyond > 0, beyond, jnp.inf))
        following = lax.stop_gradient(jnp.where(beyond > 0, jnp.clip(lowest, LEAST_STEP, 1), 1))
        gain = drop / jnp.where(expected > 0, expected, 1)
        tried = _Trial(values=moved, losses=losses, drop=drop, gain=gain, share=following)
        worse = best.drop >= drop
        return _select(worse, eqx.tree_at(lambda t: t.share, best, following), tried)

    def attempt(best: _Trial, first: Bool[Array, ""]) -> tuple[_Trial, None]:
        return lax.cond(first | (best.share < LONG_ENOUGH), evaluate, lambda t: t, best), None

    nowhere = _Trial(values=values, losses=before, drop=zero - jnp.inf, gain=zero, share=zero + 1)
    return lax.scan(attempt, nowhere, jnp.arange(tries) == 0)[0]


def _select(condition: Bool[Array, ""], a: _T, b: _T) -> _T:
    return jax.tree.map(lambda x, y: jnp.where(condition, x, y), a, b)
