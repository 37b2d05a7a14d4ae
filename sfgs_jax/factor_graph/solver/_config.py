"""Settings of the solver."""

import math
from dataclasses import dataclass
from typing import Literal, get_args

from sfgs_jax.arrays import InputError, check_choice, check_counts, check_positive, check_range

Method = Literal["levenberg_marquardt", "gauss_newton"]


@dataclass(frozen=True)
class SolverConfig:
    """Settings of `solve`; static, so a change compiles anew."""

    method: Method = "levenberg_marquardt"
    """Levenberg-Marquardt damps its steps, and takes only those that lower the cost; Gauss-Newton takes every
    step undamped."""

    max_iterations: int = 30
    """Most linear systems to solve."""

    initial_damping: float = 1e-5
    """Damping of the first step, as a share of the diagonal of the Hessian."""

    min_damping: float = 1e-7
    """Least damping, as a share of the diagonal; float32 rounds a smaller one away."""

    max_damping: float = 1e6
    """Damping, as a share of the diagonal, beyond which the solve counts as diverged."""

    cost_tolerance: float = 2e-6
    """Converged once a step is expected to lower the cost by less than this share of it."""

    step_tolerance: float = 1e-7
    """Converged once no coordinate of a step (metres, radians) is larger."""

    pcg_tolerance: float = 1e-3
    """Conjugate gradients stop at this share of the first preconditioned residual."""

    pcg_max_iterations: int = 200
    """Most products with the matrix that conjugate gradients take in one step."""

    unrolled: bool = False
    """Run `max_iterations` steps in a loop that reverse differentiation can pass through, instead of stopping
    when done. It is there to compare with `solve_implicit`, which needs less memory and time."""

    def __post_init__(self) -> None:
        check_choice(self, "method", get_args(Method))
        check_counts(self, 1, "max_iterations", "pcg_max_iterations")
        check_positive(self, "min_damping", "initial_damping", "max_damping")
        check_range(self, 0, math.inf, "cost_tolerance", "step_tolerance", "pcg_tolerance")
        if not self.min_damping <= self.initial_damping <= self.max_damping:
            raise InputError(
                f"The setting initial_damping must lie between min_damping, {self.min_damping:g}, and "
                f"max_damping, {self.max_damping:g}, not at {self.initial_damping:g}."
            )
