"""Keypoints and descriptors: the SuperFeats network, its matching, its training."""

from sfgs_jax.superfeats.features import Features as Features
from sfgs_jax.superfeats.features import Matches as Matches
