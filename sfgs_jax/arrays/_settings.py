"""Checks of settings: each names the setting, its value, and the values it may take."""

import math
from typing import Any

from sfgs_jax.arrays._errors import InputError
from sfgs_jax.arrays._excerpts import excerpt


def check_counts(settings: Any, least: int, *names: str) -> None:
    """Refuse settings that are no whole number or below `least`.

    Args:
        settings: the dataclass that holds them.
        least: smallest value allowed.
        names: the settings to check.

    Raises:
        InputError: one of them is too small or no whole number.
    """
    for name in names:
        value = getattr(settings, name)
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            raise InputError(
                f"The setting {name} must be a whole number of at least {least}, not {excerpt(value)}."
            )


def check_range(settings: Any, low: float | int, high: float | int, *names: str) -> None:
    """Refuse settings that are no finite number within [low, high].

    Args:
        settings: the dataclass that holds them.
        low: smallest value allowed.
        high: largest value allowed; infinity allows every finite number.
        names: the settings to check.

    Raises:
        InputError: one of them lies outside, is not finite or no number.
    """
    for name in names:
        value = getattr(settings, name)
        if not _is_number(value) or not (low <= value <= high and math.isfinite(value)):
            bounds = f"of at least {low:g}" if math.isinf(high) else f"between {low:g} and {high:g}"
            raise InputError(f"The setting {name} must be a number {bounds}, not {excerpt(value)}.")


def check_positive(settings: Any, *names: str) -> None:
    """Refuse settings that are no finite number above 0.

    Args:
        settings: the dataclass that holds them.
        names: the settings to check.

    Raises:
        InputError: one of them is not positive, not finite or no number.
    """
    for name in names:
        value = getattr(settings, name)
        if not _is_number(value) or not 0 < value < math.inf:
            raise InputError(f"The setting {name} must be a finite number above 0, not {excerpt(value)}.")


def check_choice(settings: Any, name: str, choices: tuple[str, ...]) -> None:
    """Refuse a setting that is none of the choices.

    Args:
        settings: the dataclass that holds it.
        name: the setting to check.
        choices: the values allowed.

    Raises:
        InputError: it is none of them.
    """
    value = getattr(settings, name)
    if value not in choices:
        raise InputError(f"The setting {name} must be one of {', '.join(choices)}, not {excerpt(value)}.")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
