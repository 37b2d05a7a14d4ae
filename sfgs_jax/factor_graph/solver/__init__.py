"""Levenberg-Marquardt, its linear solvers, implicit derivatives and marginals; here are also their parts."""

from sfgs_jax.factor_graph.solver._config import SolverConfig as SolverConfig
from sfgs_jax.factor_graph.solver._cost import cost as cost
from sfgs_jax.factor_graph.solver._implicit import differentiable_optimum as differentiable_optimum
from sfgs_jax.factor_graph.solver._implicit import solve_implicit as solve_implicit
from sfgs_jax.factor_graph.solver._levenberg_marquardt import solve as solve
from sfgs_jax.factor_graph.solver._linear_solvers import dense_matrix as dense_matrix
from sfgs_jax.factor_graph.solver._linear_solvers import prepare_solve as prepare_solve
from sfgs_jax.factor_graph.solver._marginals import Marginals as Marginals
from sfgs_jax.factor_graph.solver._marginals import marginal_covariances as marginal_covariances
from sfgs_jax.factor_graph.solver._multifrontal import Front as Front
from sfgs_jax.factor_graph.solver._multifrontal import multifrontal_cholesky as multifrontal_cholesky
from sfgs_jax.factor_graph.solver._multifrontal import multifrontal_solve as multifrontal_solve
from sfgs_jax.factor_graph.solver._multifrontal import symmetric_rank_k_blocks as symmetric_rank_k_blocks
from sfgs_jax.factor_graph.solver._normal_equations import NormalEquations as NormalEquations
from sfgs_jax.factor_graph.solver._normal_equations import build_normal_equations as build_normal_equations
from sfgs_jax.factor_graph.solver._schur_complement import Eliminated as Eliminated
from sfgs_jax.factor_graph.solver._schur_complement import ReducedSystem as ReducedSystem
from sfgs_jax.factor_graph.solver._schur_complement import landmark_steps as landmark_steps
from sfgs_jax.factor_graph.solver._schur_complement import schur_complement as schur_complement
from sfgs_jax.factor_graph.solver._solution import Solution as Solution
from sfgs_jax.factor_graph.solver._solution import Statistics as Statistics
from sfgs_jax.factor_graph.solver._solution import Status as Status
from sfgs_jax.factor_graph.solver._step import Step as Step
from sfgs_jax.factor_graph.solver._step import compute_step as compute_step
