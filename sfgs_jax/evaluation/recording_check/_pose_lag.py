"""Do poses of earlier or later frames fit the images better than those given?

A smooth motion hides poses that come late: those of some frames before are hardly different. But the turn of
each pair of frames is measured to a small part of what it changes in a few frames, so pairs are compared
one by one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sfgs_jax.evaluation.recording_check._frame_pairs import PairMotion
from sfgs_jax.evaluation.recording_check._pose_motions import LEAST_SHARE, LEAST_TURN
from sfgs_jax.geometry import rotation_vectors

FARTHEST_LAG = 15
"""Most frames that poses are tried earlier or later."""

_FEWEST = 6
_SIGMAS = 3.0
_PAIRS_OF_A_WINDOW = 4
"""Pairs of one window share frames, and count as one."""


@dataclass(frozen=True)
class PoseLag:
    """A lag by which poses fit clearly better.

    Attributes:
        frames: places after a frame's own at which its pose is; negative if before.
        gain: factor by which errors of turns shrink, the geometric mean.
        sigmas: logarithm of the gain in its standard errors.
    """

    frames: int
    gain: float
    sigmas: float


def find_pose_lag(poses: Mapping[int, np.ndarray], motions: Sequence[PairMotion]) -> PoseLag | None:
    """The lag that fits best, if it does so beyond chance.

    Errors of turns at the lag and without are compared pair by pair in their logarithms: one pair with a
    large error says no more than another.

    Args:
        poses: by numbers of frames.
        motions: of matched frames.
    """
    given = _turn_errors(poses, motions, 0)
    best: PoseLag | None = None
    for lag in range(-FARTHEST_LAG, FARTHEST_LAG + 1):
        gains = np.log(given / _turn_errors(poses, motions, lag)) if lag else np.zeros(0)
        gains = gains[np.isfinite(gains)]
        if len(gains) < _FEWEST:
            continue
        mean, error = np.mean(gains), np.std(gains) / np.sqrt(len(gains) / _PAIRS_OF_A_WINDOW)
        if mean > _SIGMAS * error and (best is None or np.exp(mean) > best.gain):
            best = PoseLag(lag, float(np.exp(mean)), float(mean / max(error, 1e-9)))
    return best


def _turn_errors(
    poses: Mapping[int, np.ndarray], motions: Sequence[PairMotion], lag: int
) -> Float[np.ndarray, " n"]:
    """Angle between measured and given turn of each pair; NaN where it does not turn or has no pose."""
    errors = np.full(len(motions), np.nan)
    for row, (pair, motion) in enumerate(motions):
        a, b = pair.first.index + lag, pair.second.index + lag
        measured = motion.T_second_first[:3, :3]
        turns = np.linalg.norm(rotation_vectors(measured[None])) > LEAST_TURN
        if a in poses and b in poses and turns and motion.share > LEAST_SHARE:
            given = poses[b][:3, :3].T @ poses[a][:3, :3]
            errors[row] = max(np.linalg.norm(rotation_vectors((given @ measured.T)[None])), 1e-6)
    return errors
