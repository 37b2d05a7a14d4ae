"""Accuracy and area under the recall curve of the errors of many pairs."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError, checked


@checked
def accuracy(errors: Float[np.ndarray, " n"], thresholds: Sequence[float]) -> Float[np.ndarray, " t"]:
    """Share of the errors below each threshold; an error that is not finite is below none.

    Args:
        errors: one of each pair.
        thresholds: in the errors' unit.

    Raises:
        InputError: there are no errors.
    """
    return np.mean(_checked(errors)[:, None] < np.asarray(thresholds), axis=0)


@checked
def area_under_curve(errors: Float[np.ndarray, " n"], thresholds: Sequence[float]) -> Float[np.ndarray, " t"]:
    """Area under the recall curve from 0 to each threshold, as a share of the whole (AUC).

    The curve goes linearly from one sorted error to the next, as is customary for relative poses.

    Source: Sarlin et al., SuperGlue, CVPR 2020, section 5.

    Args:
        errors: one of each pair.
        thresholds: in the errors' unit.

    Raises:
        InputError: there are no errors.
    """
    ordered = np.sort(_checked(errors))
    ordered = ordered[np.isfinite(ordered)]
    recall = np.arange(len(ordered) + 1) / len(errors)
    ordered = np.concatenate([[0.0], ordered])
    areas = []
    for threshold in thresholds:
        below = int(np.searchsorted(ordered, threshold))
        x = np.concatenate([ordered[:below], [threshold]])
        y = np.concatenate([recall[:below], [recall[below - 1]]])
        areas.append(np.sum(np.diff(x) * (y[1:] + y[:-1]) / 2) / threshold)
    return np.asarray(areas)


def _checked(errors: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    if not len(errors):
        raise InputError("There are no pairs to take an accuracy of.")
    return np.asarray(errors, np.float64)
