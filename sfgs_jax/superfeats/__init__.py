"""Keypoints and descriptors: the SuperFeats network, matching, and ORB behind the same types.

`sfgs_jax.superfeats.training` is imported by name: it brings in optax.
"""

from sfgs_jax.superfeats import detection as detection
from sfgs_jax.superfeats._extraction import extract as extract
from sfgs_jax.superfeats._extraction import mean_grey as mean_grey
from sfgs_jax.superfeats._features import Features as Features
from sfgs_jax.superfeats._features import Matches as Matches
from sfgs_jax.superfeats._features import pack_features as pack_features
from sfgs_jax.superfeats._matching import MIN_SIMILARITY as MIN_SIMILARITY
from sfgs_jax.superfeats._matching import Expected as Expected
from sfgs_jax.superfeats._matching import match as match
from sfgs_jax.superfeats._motion_filter import MotionFilterConfig as MotionFilterConfig
from sfgs_jax.superfeats._motion_filter import filter_by_motion as filter_by_motion
from sfgs_jax.superfeats._orb import extract_orb as extract_orb
from sfgs_jax.superfeats.network import load_weights as load_weights
from sfgs_jax.superfeats.network import save_weights as save_weights
