"""Factors: residuals with their Jacobians. Derive from `Factor` to write another kind."""

from sfgs_jax.factor_graph.factors._custom_factor import CustomFactor as CustomFactor
from sfgs_jax.factor_graph.factors._factor import Factor as Factor
from sfgs_jax.factor_graph.factors._factor import Linearised as Linearised
from sfgs_jax.factor_graph.factors._factor import Terms as Terms
from sfgs_jax.factor_graph.factors._factor import squared_mahalanobis as squared_mahalanobis
from sfgs_jax.factor_graph.factors._landmark_factors import Reprojection as Reprojection
from sfgs_jax.factor_graph.factors._landmark_factors import RgbdReprojection as RgbdReprojection
from sfgs_jax.factor_graph.factors._pose_factors import PosePrior as PosePrior
from sfgs_jax.factor_graph.factors._pose_factors import RelativePose as RelativePose
from sfgs_jax.factor_graph.factors._surface_factor import DirectGicp as DirectGicp
