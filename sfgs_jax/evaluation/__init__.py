"""Quality of a run: metrics of trajectory, images, matching and surface by named protocols; the report page.

The function `evaluate_run` computes every metric of a run's folder; `write_report` makes its page. The rest
are the metrics by themselves, in the packages `trajectory`, `images`, `matching`, `surface` and `report`.
"""

from sfgs_jax.evaluation._evaluate_run import evaluate_run as evaluate_run
from sfgs_jax.evaluation._run_folder import PosedFrames as PosedFrames
from sfgs_jax.evaluation._run_folder import posed_frames as posed_frames
from sfgs_jax.evaluation.exports import write_colmap as write_colmap
from sfgs_jax.evaluation.exports import write_nerfstudio as write_nerfstudio
from sfgs_jax.evaluation.exports import write_rerun as write_rerun
from sfgs_jax.evaluation.images import PROTOCOLS as PROTOCOLS
from sfgs_jax.evaluation.images import LpipsWeights as LpipsWeights
from sfgs_jax.evaluation.images import MapRenderer as MapRenderer
from sfgs_jax.evaluation.images import Protocol as Protocol
from sfgs_jax.evaluation.images import default_lpips_path as default_lpips_path
from sfgs_jax.evaluation.images import frames_of as frames_of
from sfgs_jax.evaluation.images import load_lpips as load_lpips
from sfgs_jax.evaluation.images import lpips as lpips
from sfgs_jax.evaluation.images import psnr as psnr
from sfgs_jax.evaluation.images import psnr_by_protocol as psnr_by_protocol
from sfgs_jax.evaluation.images import ssim_by_protocol as ssim_by_protocol
from sfgs_jax.evaluation.matching import EstimatedMotion as EstimatedMotion
from sfgs_jax.evaluation.matching import PoseError as PoseError
from sfgs_jax.evaluation.matching import accuracy as accuracy
from sfgs_jax.evaluation.matching import area_under_curve as area_under_curve
from sfgs_jax.evaluation.matching import corner_error as corner_error
from sfgs_jax.evaluation.matching import correct_matches as correct_matches
from sfgs_jax.evaluation.matching import estimate_homography as estimate_homography
from sfgs_jax.evaluation.matching import estimate_motion as estimate_motion
from sfgs_jax.evaluation.matching import matching_score as matching_score
from sfgs_jax.evaluation.matching import pose_error as pose_error
from sfgs_jax.evaluation.matching import repeatability as repeatability
from sfgs_jax.evaluation.matching import transfer as transfer
from sfgs_jax.evaluation.report import write_report as write_report
from sfgs_jax.evaluation.surface import SurfaceFigures as SurfaceFigures
from sfgs_jax.evaluation.surface import sample_triangles as sample_triangles
from sfgs_jax.evaluation.surface import seen_points as seen_points
from sfgs_jax.evaluation.surface import surface_figures as surface_figures
from sfgs_jax.evaluation.trajectory import Alignment as Alignment
from sfgs_jax.evaluation.trajectory import Ate as Ate
from sfgs_jax.evaluation.trajectory import Nees as Nees
from sfgs_jax.evaluation.trajectory import Rpe as Rpe
from sfgs_jax.evaluation.trajectory import align_points as align_points
from sfgs_jax.evaluation.trajectory import ate as ate
from sfgs_jax.evaluation.trajectory import nees as nees
from sfgs_jax.evaluation.trajectory import rpe as rpe
