"""Focal length and radial distortion that matches with depth ask for: a bundle adjustment of pairs."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from sfgs_jax.evaluation.recording_check._frame_pairs import Motion
from sfgs_jax.evaluation.recording_check._sample import RecordingSample

_ITERATIONS = 8
_STEPS = np.array([1e-4, 1e-4])


@dataclass(frozen=True)
class LensFit:
    """Focal length and distortion by least squares.

    Attributes:
        focal: factor on the focal lengths.
        radial: coefficient k1 of r^2, r in focal lengths.
        focal_sigma: standard deviation of the logarithm of the factor.
        radial_sigma: standard deviation of k1.
        corner_shift: of a corner of the image by the distortion, pixels.
    """

    focal: float
    radial: float
    focal_sigma: float
    radial_sigma: float
    corner_shift: float


def fit_lens(motions: Sequence[Motion], sample: RecordingSample) -> LensFit | None:
    """Fit one focal length and one distortion to all pairs, each with a motion of its own.

    Motions are eliminated by the Schur complement. Errors are weighted by Cauchy's kernel. The scale of depth
    does not matter.

    Args:
        motions: of pairs of frames.
        sample: where the pairs are from.

    Returns:
        None if the images don't determine it.
    """
    data = [_Pair(motion, sample) for motion in motions]
    lens = np.zeros(2)
    normal, variance = np.eye(2), 0.0
    for _ in range(_ITERATIONS):
        reduced, gradient, errors = np.zeros((2, 2)), np.zeros(2), []
        eliminated = []
        for pair in data:
            residual = pair.residual(lens)
            jacobian = pair.jacobian(lens, residual)
            weight = 1 / (1 + np.sum(residual**2, axis=1) / sample.pixel**2)
            root = np.sqrt(weight)[:, None]
            r, J = (root * residual).ravel(), (root[..., None] * jacobian).reshape(-1, 8)
            H, g = J.T @ J, J.T @ r
            H_mm = H[:6, :6] + 1e-9 * np.trace(H[:6, :6]) * np.eye(6)
            across = np.linalg.solve(H_mm, np.c_[H[:6, 6:], g[:6]])
            reduced += H[6:, 6:] - H[6:, :6] @ across[:, :2]
            gradient += g[6:] - H[6:, :6] @ across[:, 2]
            eliminated.append(across)
            errors.append(weight * np.sum(residual**2, axis=1))
        if np.linalg.cond(reduced) > 1e9:
            return None
        step = -np.linalg.solve(reduced, gradient)
        step *= min(1.0, 0.2 / np.abs(step).max())
        for pair, across in zip(data, eliminated, strict=True):
            pair.move(-across[:, 2] - across[:, :2] @ step)
        lens += step
        normal = reduced
        variance = float(np.concatenate(errors).sum()) / max(1, sum(map(len, errors)) - 6 * len(data))
    sigma = np.sqrt(np.diag(np.linalg.inv(normal)) * variance)
    matrix = sample.matrix
    corner = np.hypot(*(np.array(sample.shape[::-1]) / 2 / matrix[[0, 1], [0, 1]]))
    return LensFit(
        focal=float(np.exp(lens[0])),
        radial=float(lens[1]),
        focal_sigma=float(sigma[0]),
        radial_sigma=float(sigma[1]),
        corner_shift=float(lens[1] * corner**3 * matrix[0, 0]),
    )


class _Pair:
    """Matches of a pair, with the motion that is being adjusted."""

    def __init__(self, motion: Motion, sample: RecordingSample) -> None:
        self._matrix = sample.matrix
        self._depth = motion.points[:, 2]
        self._first = motion.points[:, :2] / self._depth[:, None]
        self._pixels = motion.pixels
        self._T = motion.T_second_first.copy()
        # Far points take part in the rotation, and the unit of depth must not matter to the solver.
        self._unit = float(np.median(self._depth))

    def residual(
        self, lens: Float[np.ndarray, " 2"], twist: Float[np.ndarray, " 6"] | None = None
    ) -> Float[np.ndarray, "n 2"]:
        """Reprojection errors in pixels."""
        focal, radial = np.exp(lens[0]), lens[1]
        rays = self._first / focal
        rays = rays * (1 - radial * np.sum(rays**2, axis=1, keepdims=True))
        points = np.c_[rays, np.ones(len(rays))] * self._depth[:, None]
        T = self._T if twist is None else _moved(self._T, twist, self._unit)
        points = points @ T[:3, :3].T + T[:3, 3]
        seen = points[:, :2] / np.maximum(points[:, 2:], 1e-3 * self._unit)
        seen = seen * (1 + radial * np.sum(seen**2, axis=1, keepdims=True))
        return focal * seen * self._matrix[[0, 1], [0, 1]] + self._matrix[:2, 2] - self._pixels

    def jacobian(
        self, lens: Float[np.ndarray, " 2"], residual: Float[np.ndarray, "n 2"]
    ) -> Float[np.ndarray, "n 2 8"]:
        """Derivatives by motion and lens, by finite differences."""
        columns = [(self.residual(lens, 1e-6 * np.eye(6)[i]) - residual) / 1e-6 for i in range(6)]
        columns += [(self.residual(lens + _STEPS[i] * np.eye(2)[i]) - residual) / _STEPS[i] for i in range(2)]
        return np.stack(columns, axis=-1)

    def move(self, twist: Float[np.ndarray, " 6"]) -> None:
        """Change the motion."""
        self._T = _moved(self._T, twist, self._unit)


def _moved(
    T: Float[np.ndarray, "4 4"], twist: Float[np.ndarray, " 6"], unit: float
) -> Float[np.ndarray, "4 4"]:
    """A motion after a small one: translation in units of the depth, then a rotation vector."""
    change = np.eye(4)
    change[:3, :3], change[:3, 3] = cv2.Rodrigues(twist[3:])[0], unit * twist[:3]
    return change @ T
