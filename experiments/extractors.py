"""SuperFeats, XFeat and ORB, each as a function from images to features with its own floor for matches."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np

from experiments import xfeat
from experiments.xfeat_size import resized_xfeat
from sfgs_jax import superfeats
from sfgs_jax.superfeats import Features, match

NAMES = ("superfeats", "xfeat", "orb")


@dataclass(frozen=True)
class Extractor:
    """A method to find and match keypoints.

    Attributes:
        name: name in tables.
        extract: features of an RGB image (H, W, 3) in [0, 1] of any size.
        min_similarity: cosine that a match must exceed.
    """

    name: str
    extract: Callable[[np.ndarray], Features]
    min_similarity: float

    def matched(self, a: Features, b: Features) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (n, 2) of matched keypoints in both images, float64 on the host."""
        matches = jax.device_get(match(a, b, min_similarity=self.min_similarity))
        points_a, points_b = (np.asarray(x.keypoints, np.float64) for x in (a, b))
        return points_a[matches.valid], points_b[matches.index_b[matches.valid]]


def make_extractor(name: str, *, max_keypoints: int, weights: Path | None) -> Extractor:
    """The extractor of a name.

    Args:
        name: one of `NAMES`.
        max_keypoints: slots for keypoints.
        weights: file with SuperFeats' weights; None means the shipped ones.
    """
    if name == "superfeats":
        params = superfeats.load_weights(weights)
        return Extractor(
            name,
            lambda image: superfeats.extract(params, image, max_keypoints=max_keypoints),
            superfeats.MIN_SIMILARITY,
        )
    if name == "xfeat":
        return Extractor(name, _XFeatOfAnySize(max_keypoints), xfeat.MIN_SIMILARITY)
    return Extractor(name, lambda image: superfeats.extract_orb(image, max_keypoints=max_keypoints), 0.0)


class _XFeatOfAnySize:
    """XFeat with a network for each image size, rounded up to the multiples of 32 that it needs."""

    def __init__(self, max_keypoints: int) -> None:
        self._max_keypoints = max_keypoints
        self._networks: dict[tuple[int, ...], xfeat.XFeat] = {}

    def __call__(self, image: np.ndarray) -> Features:
        shape = tuple(-(-side // 32) * 32 for side in image.shape[:2])
        if shape not in self._networks:
            self._networks[shape] = xfeat.XFeat(resized_xfeat(xfeat.default_weights(), *shape))
        return self._networks[shape].extract(image, max_keypoints=self._max_keypoints)
