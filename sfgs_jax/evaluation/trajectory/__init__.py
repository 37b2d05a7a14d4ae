"""Errors of an estimated trajectory: absolute, relative, and in standard deviations."""

from sfgs_jax.evaluation.trajectory._alignment import Alignment as Alignment
from sfgs_jax.evaluation.trajectory._alignment import align_points as align_points
from sfgs_jax.evaluation.trajectory._consistency import Nees as Nees
from sfgs_jax.evaluation.trajectory._consistency import nees as nees
from sfgs_jax.evaluation.trajectory._trajectory_metrics import Ate as Ate
from sfgs_jax.evaluation.trajectory._trajectory_metrics import Rpe as Rpe
from sfgs_jax.evaluation.trajectory._trajectory_metrics import ate as ate
from sfgs_jax.evaluation.trajectory._trajectory_metrics import rpe as rpe
