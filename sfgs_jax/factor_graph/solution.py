"""What `solve` returns."""

from enum import IntEnum

import equinox as eqx
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.factor_graph.values import Values


class Status(IntEnum):
    """How a solve ended."""

    CONVERGED = 0
    """No step is expected to lower the cost noticeably."""

    MAX_ITERATIONS = 1
    """Stopped by the limit on iterations; values are the best found."""

    DIVERGED = 2
    """The cost is not finite, or no step lowers it although one should; values are the best found."""

    SINGULAR = 3
    """The factors don't determine every free variable: one is touched by none, or a system that was not
    damped had no unique solution. Values are the best found, what is not determined stays where it was."""


class Statistics(eqx.Module):
    """Per iteration, in arrays of `max_iterations`; NaN, or False, where none took place.

    Attributes:
        cost: cost before the step.
        damping: share of the diagonal added.
        gain: cost drop over the drop expected of the linear model.
        step: largest coordinate of the step, metres or radians.
        accepted: whether the step was taken.
    """

    cost: Float[Array, " I"]
    damping: Float[Array, " I"]
    gain: Float[Array, " I"]
    step: Float[Array, " I"]
    accepted: Bool[Array, " I"]


class Solution(eqx.Module):
    """Values at the end, and how they came about.

    Attributes:
        values: poses and landmarks; fixed ones as given.
        cost: half the sum of robust squared whitened residuals there.
        iterations: linear systems solved.
        status: a `Status`, as an integer array.
        statistics: per iteration.
    """

    values: Values
    cost: Float[Array, ""]
    iterations: Int[Array, ""]
    status: Int[Array, ""]
    statistics: Statistics
