"""Errors of depth where nobody knows how good the depth camera is.

A depth camera may be distorted by centimetres, by millimetres, or not at all. Depth of a stereo camera is in
colour's own image, that of others is from a camera beside. An estimate of errors that are not there is noise,
which all poses then share. So each of these may be true. Registrations decide between them, and the estimate
is the mean over all.

Source: Hoeting et al., Bayesian model averaging: a tutorial (Statistical Science 1999), equations 1 to 3.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import softmax

from sfgs_jax.slam.config import TrackingConfig
from sfgs_jax.slam.state._depth_information import KNOWN, DepthInformation, DepthPrior, prior_of

ABSENT = 0.05
"""Share of cameras without such an error, among those for which it is estimated. Were it as likely as not, an
extrinsic of a centimetre would pass for none in the first frames of a room."""
SIZES = (1.0, 0.1)
"""Possible sizes of distortions, as shares of what the settings expect, at even odds. The second narrows the
deviations of distortions of 3 mm at 2 m from two millimetres to one."""
_LEAST_ODDS = 1e-6
"""Odds below which a hypothesis says nothing."""


class DepthEstimate(NamedTuple):
    """Gaussian estimate of the G parameters of a `DepthCorrection`.

    Attributes:
        mean: (G,).
        covariance: (G, G).
    """

    mean: Float[np.ndarray, " G"]
    covariance: Float[np.ndarray, "G G"]


def depth_estimate(
    depth: DepthInformation,
    config: TrackingConfig,
    *,
    absent: float = ABSENT,
    sizes: tuple[float, ...] = SIZES,
) -> DepthEstimate:
    """Parameters as registrations show them.

    Args:
        depth: what these say.
        config: settings; says whether there may be an extrinsic.
        absent: odds that depth is not distorted, and that it has no extrinsic, before the first registration.
        sizes: how large distortions may be.
    """
    hypotheses = _hypotheses(config, absent, sizes)
    evidence = [depth.log_evidence(prior) for prior, _ in hypotheses]
    odds = softmax(np.log([share for _, share in hypotheses]) + evidence)
    likely = odds > _LEAST_ODDS
    priors = [prior for (prior, _), kept in zip(hypotheses, likely, strict=True) if kept]
    odds = odds[likely] / odds[likely].sum()
    means = np.stack([depth.estimate(prior) for prior in priors])
    mean = odds @ means
    # The hypotheses are apart: that is part of what is not known.
    spreads = [
        depth.covariance(prior) + np.outer(x, x) for prior, x in zip(priors, means - mean, strict=True)
    ]
    return DepthEstimate(mean, np.einsum("h,hij->ij", odds, np.stack(spreads)))


def _hypotheses(
    config: TrackingConfig, absent: float, sizes: tuple[float, ...]
) -> list[tuple[DepthPrior, float]]:
    """All that may be true, as priors with their odds before the first registration."""
    distorted = {**dict.fromkeys(sizes, (1 - absent) / len(sizes)), KNOWN: absent}
    beside = {1.0: 1 - absent, KNOWN: absent} if config.estimate_extrinsic else {KNOWN: 1.0}
    return [
        (prior_of(config, distorted=size, beside=other), share * odds)
        for (size, share), (other, odds) in product(distorted.items(), beside.items())
        if share * odds > 0
    ]
