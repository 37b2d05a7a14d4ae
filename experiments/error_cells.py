"""Cells of tables: means with their standard errors."""

import numpy as np
from jaxtyping import Float


def standard_error(values: Float[np.ndarray, " n"]) -> float:
    """Standard error of the mean of independent samples; not a number for a single one."""
    return float(np.std(values, ddof=1) / np.sqrt(len(values))) if len(values) > 1 else float("nan")


def with_error(values: Float[np.ndarray, " n"], digits: int = 2) -> str:
    """Mean and standard error.

    Args:
        values: samples.
        digits: after the point.
    """
    return f"{np.mean(values):.{digits}f} ± {standard_error(values):.{digits}f}"


def percent(changes: Float[np.ndarray, " n"]) -> str:
    """Mean change of a logarithm as a change in per cent, with its standard error.

    Args:
        changes: of the logarithm, a sample each.
    """
    mean = np.mean(changes)
    return f"{100 * np.expm1(mean):+.1f} ± {100 * np.exp(mean) * standard_error(changes):.1f}"
