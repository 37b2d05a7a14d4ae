"""How good a run is: trajectory and image metrics with named protocols, and the report page."""

from sfgs_jax.evaluation.alignment import Alignment as Alignment
from sfgs_jax.evaluation.alignment import align_points as align_points
from sfgs_jax.evaluation.image_metrics import PROTOCOLS as PROTOCOLS
from sfgs_jax.evaluation.image_metrics import Protocol as Protocol
from sfgs_jax.evaluation.image_metrics import frames_of as frames_of
from sfgs_jax.evaluation.image_metrics import psnr as psnr
from sfgs_jax.evaluation.image_metrics import psnr_by_protocol as psnr_by_protocol
from sfgs_jax.evaluation.image_metrics import ssim_by_protocol as ssim_by_protocol
from sfgs_jax.evaluation.perceptual import LpipsWeights as LpipsWeights
from sfgs_jax.evaluation.perceptual import default_lpips_path as default_lpips_path
from sfgs_jax.evaluation.perceptual import load_lpips as load_lpips
from sfgs_jax.evaluation.perceptual import lpips as lpips
from sfgs_jax.evaluation.report import write_report as write_report
from sfgs_jax.evaluation.run import evaluate_run as evaluate_run
from sfgs_jax.evaluation.trajectory_metrics import Ate as Ate
from sfgs_jax.evaluation.trajectory_metrics import Rpe as Rpe
from sfgs_jax.evaluation.trajectory_metrics import ate as ate
from sfgs_jax.evaluation.trajectory_metrics import rpe as rpe
