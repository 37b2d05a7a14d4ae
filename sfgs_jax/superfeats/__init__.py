"""Keypoints and descriptors: the SuperFeats network, its matching, its training."""

from sfgs_jax.superfeats.extraction import extract as extract
from sfgs_jax.superfeats.extraction import mean_grey as mean_grey
from sfgs_jax.superfeats.features import Features as Features
from sfgs_jax.superfeats.features import Matches as Matches
from sfgs_jax.superfeats.matching import MIN_SIMILARITY as MIN_SIMILARITY
from sfgs_jax.superfeats.matching import match as match
from sfgs_jax.superfeats.motion_filter import MotionFilterConfig as MotionFilterConfig
from sfgs_jax.superfeats.motion_filter import filter_by_motion as filter_by_motion
from sfgs_jax.superfeats.orb import extract_orb as extract_orb
from sfgs_jax.superfeats.packing import pack_features as pack_features
from sfgs_jax.superfeats.weights import load_weights as load_weights
from sfgs_jax.superfeats.weights import save_weights as save_weights
