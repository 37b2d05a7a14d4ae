"""Metrics of keypoints and matches: on planes with a known homography, and as relative poses."""

from sfgs_jax.evaluation.matching._accuracy import accuracy as accuracy
from sfgs_jax.evaluation.matching._accuracy import area_under_curve as area_under_curve
from sfgs_jax.evaluation.matching._homography import corner_error as corner_error
from sfgs_jax.evaluation.matching._homography import correct_matches as correct_matches
from sfgs_jax.evaluation.matching._homography import estimate_homography as estimate_homography
from sfgs_jax.evaluation.matching._homography import matching_score as matching_score
from sfgs_jax.evaluation.matching._homography import repeatability as repeatability
from sfgs_jax.evaluation.matching._homography import transfer as transfer
from sfgs_jax.evaluation.matching._relative_pose import EstimatedMotion as EstimatedMotion
from sfgs_jax.evaluation.matching._relative_pose import PoseError as PoseError
from sfgs_jax.evaluation.matching._relative_pose import estimate_motion as estimate_motion
from sfgs_jax.evaluation.matching._relative_pose import pose_error as pose_error
