"""Factor graphs: poses and landmarks from measurements of all kinds at once."""

from sfgs_jax.factor_graph.config import SolverConfig as SolverConfig
from sfgs_jax.factor_graph.custom_factor import CustomFactor as CustomFactor
from sfgs_jax.factor_graph.direct_gicp import DirectGicp as DirectGicp
from sfgs_jax.factor_graph.factor import Factor as Factor
from sfgs_jax.factor_graph.graph import FactorGraph as FactorGraph
from sfgs_jax.factor_graph.landmark_factors import Reprojection as Reprojection
from sfgs_jax.factor_graph.landmark_factors import RgbdReprojection as RgbdReprojection
from sfgs_jax.factor_graph.optimise import cost as cost
from sfgs_jax.factor_graph.optimise import solve as solve
from sfgs_jax.factor_graph.pose_factors import PosePrior as PosePrior
from sfgs_jax.factor_graph.pose_factors import RelativePose as RelativePose
from sfgs_jax.factor_graph.solution import Solution as Solution
from sfgs_jax.factor_graph.solution import Statistics as Statistics
from sfgs_jax.factor_graph.solution import Status as Status
from sfgs_jax.factor_graph.structure import Capacities as Capacities
from sfgs_jax.factor_graph.values import Values as Values
