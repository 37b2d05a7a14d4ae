"""Factor graphs: poses and landmarks from measurements of all kinds at once.

Build factors, lay them out in a `FactorGraph`, and `solve` it from some `Values`. The parts that compose a
solver are in `factors`, `problem`, `solver` and `start`.
"""

from sfgs_jax.factor_graph._g2o import PoseGraph as PoseGraph
from sfgs_jax.factor_graph._g2o import read_g2o as read_g2o
from sfgs_jax.factor_graph._g2o import write_g2o as write_g2o
from sfgs_jax.factor_graph._pairwise_consistency import consistent_loops as consistent_loops
from sfgs_jax.factor_graph._pairwise_consistency import within_threshold as within_threshold
from sfgs_jax.factor_graph._plot import plot_graph as plot_graph
from sfgs_jax.factor_graph._values import Values as Values
from sfgs_jax.factor_graph._values import retract as retract
from sfgs_jax.factor_graph.factors import CustomFactor as CustomFactor
from sfgs_jax.factor_graph.factors import DirectGicp as DirectGicp
from sfgs_jax.factor_graph.factors import Factor as Factor
from sfgs_jax.factor_graph.factors import PosePrior as PosePrior
from sfgs_jax.factor_graph.factors import RelativePose as RelativePose
from sfgs_jax.factor_graph.factors import Reprojection as Reprojection
from sfgs_jax.factor_graph.factors import RgbdReprojection as RgbdReprojection
from sfgs_jax.factor_graph.problem import Capacities as Capacities
from sfgs_jax.factor_graph.problem import FactorGraph as FactorGraph
from sfgs_jax.factor_graph.solver import Marginals as Marginals
from sfgs_jax.factor_graph.solver import Solution as Solution
from sfgs_jax.factor_graph.solver import SolverConfig as SolverConfig
from sfgs_jax.factor_graph.solver import Statistics as Statistics
from sfgs_jax.factor_graph.solver import Status as Status
from sfgs_jax.factor_graph.solver import cost as cost
from sfgs_jax.factor_graph.solver import differentiable_optimum as differentiable_optimum
from sfgs_jax.factor_graph.solver import marginal_covariances as marginal_covariances
from sfgs_jax.factor_graph.solver import solve as solve
from sfgs_jax.factor_graph.solver import solve_implicit as solve_implicit
from sfgs_jax.factor_graph.start import chordal_start as chordal_start
from sfgs_jax.factor_graph.start import spanning_tree_start as spanning_tree_start
