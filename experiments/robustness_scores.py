"""Figures of a run over a perturbed recording: above all, whether it was wrong without saying so."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from sfgs_jax.evaluation import align_points

AUC_LIMIT_M = 0.5
WRONG_M = 0.1
"""A pose further off is wrong."""
FIRST_FRAMES = 20
"""Poses that a path is aligned by, before it could drift."""


@dataclass(frozen=True)
class Scores:
    """Figures of one run.

    Attributes:
        tracked: share of all frames that the run gave a pose.
        auc: area under the share of all frames whose error is below a threshold, for thresholds from 0 to
            0.5 m, as a share of the whole. Errors are those of the final path after rigid alignment; a lost
            frame is below none.
        silent_wrong: share of the tracked frames that were more than 10 cm off when their pose was given,
            after alignment on the first 20.
        worst_m: largest of these errors, metres; NaN if nothing was tracked.
        recovery: longest row of frames that were lost or wrong, of those with something to see; NaN if the
            last row never ended.
    """

    tracked: float
    auc: float
    silent_wrong: float
    worst_m: float
    recovery: float


def scores(
    live: Float[np.ndarray, "n 4 4"],
    final: Float[np.ndarray, "n 4 4"],
    truth: Float[np.ndarray, "n 4 4"],
    disturbed: Bool[np.ndarray, " n"],
) -> Scores:
    """Compare the poses of a run with the truth; a pose that is not known is NaN.

    Args:
        live: `T_world_cam` as it was given with each frame.
        final: the same at the end of the run.
        truth: the true ones.
        disturbed: frames whose images say nothing about the pose.
    """
    tracked = np.isfinite(live).all((1, 2))
    off = _errors_from_start(live, truth)
    wrong = off > WRONG_M
    return Scores(
        tracked=float(tracked.mean()),
        auc=float(np.mean(np.clip(1 - _errors_aligned(final, truth) / AUC_LIMIT_M, 0, 1))),
        silent_wrong=float(np.sum(wrong & tracked) / max(1, tracked.sum())),
        worst_m=float(np.nanmax(off)) if np.isfinite(off).any() else np.nan,
        recovery=_longest_row((~tracked | wrong)[~disturbed]),
    )


def _errors_from_start(
    estimate: Float[np.ndarray, "n 4 4"], truth: Float[np.ndarray, "n 4 4"]
) -> Float[np.ndarray, " n"]:
    """Distance of each position after the mean motion between the first poses, NaN for unknown ones.

    Poses, unlike positions, give the rotation of a path that has hardly begun.
    """
    known = np.flatnonzero(_both(estimate, truth))
    off = np.full(len(truth), np.nan)
    first = known[:FIRST_FRAMES]
    if not len(first):
        return off
    u, _, vt = np.linalg.svd((truth[first, :3, :3] @ estimate[first, :3, :3].swapaxes(1, 2)).sum(0))
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    moved = estimate[:, :3, 3] @ rotation.T
    shift = (truth[first, :3, 3] - moved[first]).mean(0)
    off[known] = np.linalg.norm(moved[known] + shift - truth[known, :3, 3], axis=1)
    return off


def _errors_aligned(
    estimate: Float[np.ndarray, "n 4 4"], truth: Float[np.ndarray, "n 4 4"]
) -> Float[np.ndarray, " n"]:
    """Distance of each position after the best rigid alignment of all, infinite for unknown ones."""
    known = _both(estimate, truth)
    off = np.full(len(truth), np.inf)
    if known.sum() >= 3:
        here, there = estimate[known, :3, 3], truth[known, :3, 3]
        off[known] = np.linalg.norm(align_points(here, there).transform(here) - there, axis=1)
    return off


def _both(estimate: Float[np.ndarray, "n 4 4"], truth: Float[np.ndarray, "n 4 4"]) -> Bool[np.ndarray, " n"]:
    return np.isfinite((estimate + truth).sum((1, 2)))


def _longest_row(bad: Bool[np.ndarray, " n"]) -> float:
    """Length of the longest row of bad frames; NaN if the last frame is bad."""
    if not len(bad) or bad[-1]:
        return np.nan
    ends = np.flatnonzero(np.diff(np.concatenate([[False], bad, [False]]).astype(int)))
    return float(max(np.diff(ends)[::2], default=0))
