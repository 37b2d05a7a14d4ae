"""Distances of a reconstructed surface from a reference: accuracy, completeness, F1."""

from sfgs_jax.evaluation.surface._sampling import sample_triangles as sample_triangles
from sfgs_jax.evaluation.surface._sampling import seen_points as seen_points
from sfgs_jax.evaluation.surface._surface_metrics import SurfaceFigures as SurfaceFigures
from sfgs_jax.evaluation.surface._surface_metrics import surface_figures as surface_figures
