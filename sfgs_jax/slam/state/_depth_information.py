"""Sum of what registrations say about the distortion of depth."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag, solve_triangular

from sfgs_jax.arrays import pytree
from sfgs_jax.sensors import DEPTH_GRID
from sfgs_jax.slam.config import TrackingConfig

KNOWN = 1e-4
"""Share of a deviation that is left of it where an error is taken to be what the estimate starts from."""


@pytree
@dataclass(frozen=True, eq=False)
class DepthInformation:
    """Normal equations of the G parameters of a `DepthCorrection`, summed over registrations, on the host.

    The unknown is their difference from those that the estimate started from.

    Attributes:
        start: (G,) parameters before the first registration, the mean of the prior.
        information: (G, G) of the sum, the prior not among it.
        vector: (G,) right-hand side.
        chi_square: sum over the registrations of the squared surprise: how far the estimate before was from
            what the registration said, in standard deviations of their difference.
        expected: what that sum would be if registrations were as good as their information says.
    """

    start: Float[np.ndarray, " G"]
    information: Float[np.ndarray, "G G"]
    vector: Float[np.ndarray, " G"]
    chi_square: float
    expected: float

    @property
    def excess(self) -> float:
        """Variance of the registrations over what their information says, at least 1."""
        return max(1.0, self.chi_square / self.expected) if self.expected else 1.0

    def plus(
        self,
        information: Float[np.ndarray, "G G"],
        vector: Float[np.ndarray, " G"],
        offsets: Float[np.ndarray, " G"],
        prior: "DepthPrior",
    ) -> "DepthInformation":
        """The sum with a registration's equations.

        Args:
            information: (G, G) of one registration.
            vector: (G,) its right-hand side, for the difference from the parameters that it was found with.
            offsets: (G,) these.
            prior: of the parameters.
        """
        vector = vector + information @ (offsets - self.start)
        told = prior.root.T @ information @ prior.root
        off = prior.root.T @ (vector - information @ (self.estimate(prior) - self.start))
        # If all registrations have the same excess, so has the estimate before, and the surprise shows it.
        before = prior.root.T @ (self.information + prior.information) @ prior.root
        surprise, count = _surprise(told, off, np.linalg.inv(before))
        return DepthInformation(
            self.start,
            self.information + information,
            self.vector + vector,
            self.chi_square + surprise,
            self.expected + count,
        )

    def joined(self, other: "DepthInformation") -> "DepthInformation":
        """The sum with that of other registrations of the same camera; the start stays.

        Args:
            other: sum over these, which may have another start.
        """
        return DepthInformation(
            self.start,
            self.information + other.information,
            self.vector + other.vector + other.information @ (other.start - self.start),
            self.chi_square + other.chi_square,
            self.expected + other.expected,
        )

    def estimate(self, prior: "DepthPrior") -> Float[np.ndarray, " G"]:
        """(G,) most likely parameters.

        Args:
            prior: of the parameters.
        """
        return self.start + np.linalg.solve(self._posterior(prior), self.vector / self.excess)

    def covariance(self, prior: "DepthPrior") -> Float[np.ndarray, "G G"]:
        """(G, G) covariance of the estimate; larger where registrations contradict each other.

        Args:
            prior: of the parameters.
        """
        return np.linalg.inv(self._posterior(prior))

    def log_evidence(self, prior: "DepthPrior") -> float:
        """Logarithm of how likely the registrations are by a prior, but for what all priors have in common.

        Args:
            prior: of the parameters.
        """
        root = np.linalg.cholesky(self._posterior(prior))
        explained = solve_triangular(root, self.vector / self.excess, lower=True)
        narrowed = np.log(np.diag(root)).sum() + np.log(np.diag(prior.root)).sum()
        return float(explained @ explained / 2 - narrowed)

    def _posterior(self, prior: "DepthPrior") -> Float[np.ndarray, "G G"]:
        return self.information / self.excess + prior.information


def _surprise(
    told: Float[np.ndarray, "G G"], off: Float[np.ndarray, " G"], covariance: Float[np.ndarray, "G G"]
) -> tuple[float, float]:
    """Squared surprise of a registration, and what to expect of it.

    Only directions count that the registration knows better than the prior did.

    Args:
        told: information of the registration, in the prior's standard deviations.
        off: its right-hand side, less that of the estimate before.
        covariance: of the estimate before.
    """
    values, vectors = np.linalg.eigh(told)
    known = values > 1
    roots, vectors = np.sqrt(values[known]), vectors[:, known]
    difference = vectors.T @ off / roots
    spread = np.eye(len(roots)) + roots[:, None] * (vectors.T @ covariance @ vectors) * roots[None]
    return float(difference @ np.linalg.solve(spread, difference)), float(len(roots))


@dataclass(frozen=True, eq=False)
class DepthPrior:
    """Gaussian prior of the parameters; its mean is the start of the estimate.

    Attributes:
        information: (G, G).
        root: (G, G) lower Cholesky factor of its covariance.
    """

    information: Float[np.ndarray, "G G"]
    root: Float[np.ndarray, "G G"]


def depth_prior(shape: tuple[int, int], sigma: float, step_sigma: float, tilt_sigma: float) -> DepthPrior:
    """Prior of offsets that are small and vary smoothly, but for a tilt.

    Two sensors that are turned against each other, or a projector, measure disparities with a linear error.

    Args:
        shape: rows and columns of the grid.
        sigma: standard deviation of an offset, 1/m.
        step_sigma: standard deviation of the difference between neighbouring nodes, 1/m.
        tilt_sigma: standard deviation of the offset at the borders by a tilt about either axis, 1/m.
    """
    numbers = np.arange(shape[0] * shape[1]).reshape(shape)
    smooth = np.eye(numbers.size) / sigma**2
    for a, b in ((numbers[:, :-1], numbers[:, 1:]), (numbers[:-1], numbers[1:])):
        step = np.eye(numbers.size)[b.ravel()] - np.eye(numbers.size)[a.ravel()]
        smooth += step.T @ step / step_sigma**2
    down, across = np.meshgrid(*(np.linspace(-1, 1, n) for n in shape), indexing="ij")
    tilts = tilt_sigma * np.stack([down.ravel(), across.ravel()])
    covariance = np.linalg.inv(smooth) + tilts.T @ tilts
    return DepthPrior(np.linalg.inv(covariance), np.linalg.cholesky(covariance))


def with_extrinsic(prior: DepthPrior, shift_sigma: float, turn_sigma: float) -> DepthPrior:
    """The prior of all parameters: of the offsets, and of an extrinsic that has nothing to do with them.

    Args:
        prior: of the offsets.
        shift_sigma: standard deviation of each coordinate of the translation, metres.
        turn_sigma: standard deviation of the rotation about each axis, radians.
    """
    sigmas = np.repeat([shift_sigma, turn_sigma], 3)
    parts = (prior.information, np.diag(sigmas**-2.0)), (prior.root, np.diag(sigmas))
    return DepthPrior(*(np.asarray(block_diag(*blocks)) for blocks in parts))


def prior_of(config: TrackingConfig, *, distorted: float = 1.0, beside: float = 1.0) -> DepthPrior:
    """Prior of the errors of depth, as known before the first frame.

    Args:
        config: settings.
        distorted: factor on the deviations of the offsets.
        beside: factor on those of the extrinsic.
    """
    offsets = config.depth_sigma, config.depth_step_sigma, config.depth_tilt_sigma
    extrinsic = config.extrinsic_shift_sigma, config.extrinsic_turn_sigma
    beside = beside if config.estimate_extrinsic else KNOWN
    return _prior(tuple(distorted * x for x in offsets), tuple(beside * x for x in extrinsic))


@cache
def _prior(offsets: tuple[float, ...], extrinsic: tuple[float, ...]) -> DepthPrior:
    return with_extrinsic(depth_prior(DEPTH_GRID, *offsets), *extrinsic)


def no_depth_information(start: Float[np.ndarray, " G"]) -> DepthInformation:
    """Nothing, as before the first registration.

    Args:
        start: (G,) parameters to start from.
    """
    return DepthInformation(start, np.zeros((len(start), len(start))), np.zeros(len(start)), 0.0, 0.0)
