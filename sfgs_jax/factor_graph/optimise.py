"""Gauss-Newton and Levenberg-Marquardt, in one loop."""

from functools import partial
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.factor_graph.anchor import move_back
from sfgs_jax.factor_graph.config import SolverConfig
from sfgs_jax.factor_graph.graph import FactorGraph
from sfgs_jax.factor_graph.linear_solvers import prepare_solve
from sfgs_jax.factor_graph.normal_equations import NormalEquations, landmark_steps, linearise, reduce
from sfgs_jax.factor_graph.solution import Solution, Statistics, Status
from sfgs_jax.factor_graph.values import Values, retract
from sfgs_jax.geometry import InputError

LONG_ENOUGH = 0.8
"""A shorter step is tried too where the cost seems to be lowest at a smaller share of the step."""

LEAST_STEP = 0.1
"""Least share of the step to try."""

_RUNNING = -1
_T = TypeVar("_T")

Losses = tuple[Float[Array, "..."], ...]


class _State(eqx.Module):
    values: Values
    losses: Losses
    damping: Float[Array, ""]
    growth: Float[Array, ""]
    iteration: Int[Array, ""]
    status: Int[Array, ""]
    undetermined: Bool[Array, ""]
    statistics: Statistics


class _Trial(eqx.Module):
    """Where a share of a step leads, and the share to try next."""

    values: Values
    losses: Losses
    drop: Float[Array, ""]
    gain: Float[Array, ""]
    share: Float[Array, ""]


class Step(eqx.Module):
    """A step and what the linear model says of it.

    Attributes:
        poses: (P, 6) tangents.
        landmarks: (L, 3) metres.
        expected: drop of the cost in the linear model.
        slope: drop of the cost per share of the step, at its beginning.
        finite: whether the system could be solved.
        deficient: whether a landmark's block had no unique solution.
    """

    poses: Float[Array, "P 6"]
    landmarks: Float[Array, "L 3"]
    expected: Float[Array, ""]
    slope: Float[Array, ""]
    finite: Bool[Array, ""]
    deficient: Bool[Array, ""]


def solve(graph: FactorGraph, values: Values, config: SolverConfig | None = None) -> Solution:
    """Values that minimise half the sum of robust squared whitened residuals, near the given ones.

    Levenberg-Marquardt with the damping of Nielsen, Damping parameter in Marquardt's method (1999), eq. 2.4,
    on the diagonal of the Hessian; kernels by iteratively reweighted least squares. A step is judged by the
    sum of the residuals' differences, not by the difference of two sums, which float32 would round away.

    Args:
        graph: factors and structure.
        values: where to start.
        config: settings, `SolverConfig()` if not given.

    Raises:
        InputError: numbers of poses or landmarks that don't match the graph's.
    """
    check_sizes(graph, values)
    return _solve(graph, values, SolverConfig() if config is None else config)


def check_sizes(graph: FactorGraph, values: Values) -> None:
    """Refuse values with other numbers of poses or landmarks than the graph's."""
    given = values.poses.wxyz_xyz.shape[-2], values.landmarks.shape[-2]
    if given != (graph.num_poses, graph.num_landmarks):
        raise InputError(
            f"The values hold {given[0]} poses and {given[1]} landmarks, the graph "
            f"{graph.num_poses} and {graph.num_landmarks}."
        )


def cost(graph: FactorGraph, values: Values) -> Float[Array, ""]:
    """Half the sum of robust squared whitened residuals."""
    return _cost(all_losses(graph, values), values)


def all_losses(graph: FactorGraph, values: Values) -> Losses:
    """Robust squared whitened residuals of every factor block."""
    return tuple(factor.losses(values) for factor in graph.factors)


def compute_step(
    graph: FactorGraph, equations: NormalEquations, damping: Float[Array, ""], config: SolverConfig
) -> Step:
    """Solution of the damped normal equations."""
    reduced, eliminated, deficient = reduce(graph, equations, damping)
    linear_solve = prepare_solve(
        graph,
        reduced,
        pcg_tolerance=config.pcg_tolerance,
        pcg_max_iterations=config.pcg_max_iterations,
    )
    poses = linear_solve(reduced.right)
    landmarks = landmark_steps(graph, eliminated, poses)
    finite = jnp.all(jnp.isfinite(poses)) & jnp.all(jnp.isfinite(landmarks))
    poses, landmarks = jnp.where(finite, poses, 0), jnp.where(finite, landmarks, 0)
    # With (H + damping D) step = -g the model drops by (damping step D step - g step) / 2.
    s = graph.structure
    diagonal = jnp.diagonal(equations.diagonal, axis1=1, axis2=2)
    resisted = jnp.sum(damping * diagonal * poses**2)
    slope = -jnp.sum(poses * equations.gradient)
    point_diagonal = jnp.diagonal(equations.landmark_hessian, axis1=2, axis2=3)
    padded = jnp.concatenate([landmarks, jnp.zeros((1, 3), landmarks.dtype)])
    points = padded[jnp.asarray(s.cluster_landmarks)]
    resisted += jnp.sum(damping * point_diagonal * points**2)
    slope -= jnp.sum(points * equations.landmark_gradient)
    return Step(poses, landmarks, (resisted + slope) / 2, slope, finite, deficient)


@partial(jax.jit, static_argnames="config")
def _solve(graph: FactorGraph, values: Values, config: SolverConfig) -> Solution:
    if graph.anchor is not None and config.method == "levenberg_marquardt":
        free = jnp.asarray(graph.free_poses)
        afloat = eqx.tree_at(
            lambda g: (g.free_poses, g.anchor), graph, (free.at[graph.anchor].set(True), None)
        )
        solution = _solve(afloat, values, config)
        back = move_back(solution.values, values, graph.anchor, free)
        return eqx.tree_at(lambda s: s.values, solution, back)
    dtype = values.poses.wxyz_xyz.dtype
    losses = tuple(jnp.zeros(len(factor.valid), dtype) for factor in graph.factors)
    empty = jnp.full(config.max_iterations, jnp.nan, dtype)
    state = _State(
        values,
        losses,
        jnp.asarray(config.initial_damping if config.method == "levenberg_marquardt" else 0, dtype),
        jnp.asarray(2, dtype),
        jnp.asarray(0),
        jnp.asarray(_RUNNING),
        jnp.asarray(False),
        Statistics(empty, empty, empty, empty, jnp.zeros(config.max_iterations, bool)),
    )
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
    lost = state.undetermined & (status != Status.DIVERGED.value)
    return Solution(
        state.values,
        _cost(state.losses, values),
        state.iteration,
        jnp.where(lost, Status.SINGULAR.value, status),
        state.statistics,
    )


def _iterate(graph: FactorGraph, config: SolverConfig, state: _State) -> _State:
    marquardt = config.method == "levenberg_marquardt"
    equations = linearise(graph, state.values)
    step = compute_step(graph, equations, state.damping, config)
    # The first step starts from what the factors are linearised at, the others where the last one led.
    begun = state.iteration > 0
    before = tuple(_select(begun, a, b) for a, b in zip(state.losses, equations.losses, strict=True))
    current = _cost(before, state.values)
    trial = _descend(graph, state.values, before, step, tries=2 if marquardt else 1)
    moved, losses, drop, gain = trial.values, trial.losses, trial.drop, trial.gain
    finite = step.finite & jnp.isfinite(drop)
    small = step.expected <= config.cost_tolerance * current
    largest = jnp.maximum(
        jnp.max(jnp.abs(step.poses)), jnp.max(jnp.abs(step.landmarks), initial=jnp.zeros((), current.dtype))
    )
    done = step.finite & (small | (largest <= config.step_tolerance))
    better = finite & (drop > 0)
    accepted = better if marquardt else finite

    # Nielsen: shrink the more, the better the model was; grow faster with every failure in a row.
    shrink = jnp.maximum(1 / 3, 1 - (2 * gain - 1) ** 3)
    lower = jnp.maximum(state.damping * shrink, config.min_damping)
    damping = jnp.where(accepted, lower, state.damping * state.growth) if marquardt else state.damping
    growth = jnp.where(accepted, 2, 2 * state.growth).astype(state.growth.dtype)

    if marquardt:
        failed = jnp.where(damping > config.max_damping, Status.DIVERGED.value, _RUNNING)
    else:
        unsolved = jnp.where(step.finite, Status.DIVERGED.value, Status.SINGULAR.value)
        failed = jnp.where(accepted, _RUNNING, unsolved)
    status = jnp.where(done, Status.CONVERGED.value, failed)
    status = jnp.where(jnp.isfinite(current), status, Status.DIVERGED.value)
    undetermined = equations.undetermined
    if not marquardt:
        undetermined |= step.deficient
    i, old = state.iteration, state.statistics
    statistics = Statistics(
        old.cost.at[i].set(current),
        old.damping.at[i].set(state.damping),
        old.gain.at[i].set(gain),
        old.step.at[i].set(largest),
        old.accepted.at[i].set(accepted),
    )
    values, losses = _select(accepted, (moved, losses), (state.values, before))
    return _State(values, losses, damping, growth, i + 1, status, undetermined, statistics)


def _descend(graph: FactorGraph, values: Values, before: Losses, step: Step, *, tries: int) -> _Trial:
    """The whole step, or a share of it if that is better.

    Where the cost curves more than its model does, the step leads too far. The second try goes to the lowest
    point of the parabola that has the cost at both ends of the first and its slope at the beginning.
    """
    zero = jnp.zeros((), step.slope.dtype)

    def evaluate(best: _Trial) -> _Trial:
        share = best.share
        moved = retract(values, share * step.poses, share * step.landmarks)
        losses = all_losses(graph, moved)
        drop = _drop(before, losses, values)
        expected = share * step.slope - share**2 * (step.slope - step.expected)
        beyond = step.slope - drop
        lowest = step.slope / (2 * jnp.where(beyond > 0, beyond, jnp.inf))
        following = lax.stop_gradient(jnp.where(beyond > 0, jnp.clip(lowest, LEAST_STEP, 1), 1))
        tried = _Trial(moved, losses, drop, drop / jnp.where(expected > 0, expected, 1), following)
        worse = best.drop >= drop
        return _select(worse, eqx.tree_at(lambda t: t.share, best, following), tried)

    def attempt(best: _Trial, first: Bool[Array, ""]) -> tuple[_Trial, None]:
        return lax.cond(first | (best.share < LONG_ENOUGH), evaluate, lambda t: t, best), None

    nowhere = _Trial(values, before, zero - jnp.inf, zero, zero + 1)
    return lax.scan(attempt, nowhere, jnp.arange(tries) == 0)[0]


def _select(condition: Bool[Array, ""], a: _T, b: _T) -> _T:
    return jax.tree.map(lambda x, y: jnp.where(condition, x, y), a, b)


def _cost(losses: Losses, values: Values) -> Float[Array, ""]:
    return sum((_sum(x) for x in losses), jnp.zeros((), values.poses.wxyz_xyz.dtype)) / 2


def _drop(before: Losses, after: Losses, values: Values) -> Float[Array, ""]:
    return _cost(tuple(a - b for a, b in zip(before, after, strict=True)), values)


def _sum(lanes: Float[Array, " N"]) -> Float[Array, ""]:
    """Sum in two stages, so that rounding errors grow with the length of a stage, not of the whole."""
    size = max(1, int(len(lanes) ** 0.5))
    padded = jnp.pad(lanes, (0, -len(lanes) % size))
    return jnp.sum(jnp.sum(padded.reshape(-1, size), axis=0))
