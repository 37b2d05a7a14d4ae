"""The graph, and the layout of its arrays: everything that is decided on the host, before a solve."""

from sfgs_jax.factor_graph.problem._capacities import Capacities as Capacities
from sfgs_jax.factor_graph.problem._elimination_plan import EliminationPlan as EliminationPlan
from sfgs_jax.factor_graph.problem._elimination_plan import plan_elimination as plan_elimination
from sfgs_jax.factor_graph.problem._graph import FactorGraph as FactorGraph
from sfgs_jax.factor_graph.problem._graph import check_values as check_values
from sfgs_jax.factor_graph.problem._layout import Structure as Structure
from sfgs_jax.factor_graph.problem._separator import minimum_vertex_cover as minimum_vertex_cover
