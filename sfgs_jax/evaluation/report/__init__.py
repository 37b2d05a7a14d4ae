"""report.html: one self-contained page that shows a run."""

from sfgs_jax.evaluation.report._compared_views import ComparedView as ComparedView
from sfgs_jax.evaluation.report._compared_views import compared_views as compared_views
from sfgs_jax.evaluation.report._pictures import depth_picture as depth_picture
from sfgs_jax.evaluation.report._pictures import rgb_picture as rgb_picture
from sfgs_jax.evaluation.report._plots import plot_errors as plot_errors
from sfgs_jax.evaluation.report._plots import plot_paths as plot_paths
from sfgs_jax.evaluation.report._report import write_report as write_report
