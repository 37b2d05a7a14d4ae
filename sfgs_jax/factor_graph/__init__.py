"""Factor graphs: poses and landmarks from measurements of all kinds at once."""

from sfgs_jax.factor_graph.capacities import Capacities as Capacities
from sfgs_jax.factor_graph.config import SolverConfig as SolverConfig
from sfgs_jax.factor_graph.consistency import consistent_loops as consistent_loops
from sfgs_jax.factor_graph.consistency import within_threshold as within_threshold
from sfgs_jax.factor_graph.custom_factor import CustomFactor as CustomFactor
from sfgs_jax.factor_graph.direct_gicp import DirectGicp as DirectGicp
from sfgs_jax.factor_graph.factor import Factor as Factor
from sfgs_jax.factor_graph.g2o import PoseGraph as PoseGraph
from sfgs_jax.factor_graph.g2o import read_g2o as read_g2o
from sfgs_jax.factor_graph.g2o import write_g2o as write_g2o
from sfgs_jax.factor_graph.graph import FactorGraph as FactorGraph
from sfgs_jax.factor_graph.implicit import solve_implicit as solve_implicit
from sfgs_jax.factor_graph.landmark_factors import Reprojection as Reprojection
from sfgs_jax.factor_graph.landmark_factors import RgbdReprojection as RgbdReprojection
from sfgs_jax.factor_graph.marginals import Marginals as Marginals
from sfgs_jax.factor_graph.marginals import marginal_covariances as marginal_covariances
from sfgs_jax.factor_graph.odometry import odometry_start as odometry_start
from sfgs_jax.factor_graph.optimise import cost as cost
from sfgs_jax.factor_graph.optimise import solve as solve
from sfgs_jax.factor_graph.plot import plot_graph as plot_graph
from sfgs_jax.factor_graph.pose_factors import PosePrior as PosePrior
from sfgs_jax.factor_graph.pose_factors import RelativePose as RelativePose
from sfgs_jax.factor_graph.solution import Solution as Solution
from sfgs_jax.factor_graph.solution import Statistics as Statistics
from sfgs_jax.factor_graph.solution import Status as Status
from sfgs_jax.factor_graph.values import Values as Values
