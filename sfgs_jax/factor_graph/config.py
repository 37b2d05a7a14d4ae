"""Settings of the solver."""

from dataclasses import dataclass
from typing import Literal

Method = Literal["levenberg_marquardt", "gauss_newton"]


@dataclass(frozen=True)
class SolverConfig:
    """Settings of `solve`; static, so a change compiles anew."""

    method: Method = "levenberg_marquardt"
    """Gauss-Newton takes every step; Levenberg-Marquardt damps them, and takes only those that help."""

    max_iterations: int = 30
    """Most linear systems to solve."""

    initial_damping: float = 1e-5
    """First damping, as a share of the diagonal of the Hessian."""

    min_damping: float = 1e-7
    """Least damping; below it float32 loses what it does."""

    max_damping: float = 1e6
    """Damping at which no step that helps is thought to exist."""

    cost_tolerance: float = 2e-6
    """Converged once the step expects to lower the cost by less than this share of it."""

    step_tolerance: float = 1e-7
    """Converged once no coordinate of a step (metres, radians) is larger."""

    pcg_tolerance: float = 1e-3
    """Conjugate gradients: residual at which to stop, as a share of the first, where preconditioned."""

    pcg_max_iterations: int = 200
    """Conjugate gradients: most products with the matrix in one step."""

    unrolled: bool = False
    """Run `max_iterations` steps in a loop that reverse differentiation can pass through, instead of
    stopping when done: for comparison with `solve_implicit`, which costs less memory and time."""
