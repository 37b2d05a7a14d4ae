"""Result of a solve: values, cost, status, and statistics per iteration."""

from enum import IntEnum
from typing import Any

import equinox as eqx
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.arrays import is_array, is_known, printed_fields
from sfgs_jax.factor_graph._values import Values


class Status(IntEnum):
    """End of a solve. Values are finite, and the best found, in every case."""

    CONVERGED = 0
    """No step is expected to lower the cost noticeably."""

    MAX_ITERATIONS = 1
    """The limit on iterations was reached."""

    DIVERGED = 2
    """The cost is not finite, or no step lowers it although one should."""

    SINGULAR = 3
    """The factors don't determine every free variable. No factor touches one, or an undamped system had no
    unique solution. An undetermined variable stays at its start."""

    def __str__(self) -> str:
        return self.name


class Statistics(eqx.Module):
    """Progress per iteration, in arrays of `max_iterations`; NaN, or False, after the last one.

    Attributes:
        cost: (I,) cost before the step.
        damping: (I,) share of the diagonal added.
        gain: (I,) drop of the cost over the drop that the linear model expected.
        step: (I,) largest coordinate of the step, metres or radians.
        accepted: (I,) whether the step was taken.
    """

    cost: Float[Array, " I"]
    damping: Float[Array, " I"]
    gain: Float[Array, " I"]
    step: Float[Array, " I"]
    accepted: Bool[Array, " I"]


class Solution(eqx.Module):
    """Result of `solve`.

    Attributes:
        values: poses and landmarks; fixed ones as given.
        cost: half the sum of robust squared whitened residuals there.
        iterations: linear systems solved.
        status_code: number of the `Status`.
        statistics: progress per iteration.
    """

    values: Values
    cost: Float[Array, ""]
    iterations: Int[Array, ""]
    status_code: Int[Array, ""]
    statistics: Statistics

    @property
    def status(self) -> Status | Int[Array, "*b"]:
        """The `Status`, which prints its name; its number where it is traced or batched."""
        return _named(self.status_code)

    def __repr__(self) -> str:
        return printed_fields(
            "Solution",
            status=_named(self.status_code),
            cost=self.cost,
            iterations=self.iterations,
            values=self.values,
        )


def _named(code: Any) -> Any:
    """The `Status` of a number; a traced or batched one, or anything else, as it is."""
    return Status(int(code)) if is_array(code) and is_known(code) and code.ndim == 0 else code
