"""Image metrics of a rendered map (PSNR, SSIM, LPIPS) by the protocols that papers use."""

from sfgs_jax.evaluation.images._frame_figures import FRAMES_FILE as FRAMES_FILE
from sfgs_jax.evaluation.images._frame_figures import FrameFigures as FrameFigures
from sfgs_jax.evaluation.images._frame_figures import format_frames as format_frames
from sfgs_jax.evaluation.images._frame_figures import mean_by_protocol as mean_by_protocol
from sfgs_jax.evaluation.images._frame_figures import read_frames as read_frames
from sfgs_jax.evaluation.images._image_evaluation import LPIPS_PROTOCOL as LPIPS_PROTOCOL
from sfgs_jax.evaluation.images._image_evaluation import OPAQUE as OPAQUE
from sfgs_jax.evaluation.images._image_evaluation import ImageFigures as ImageFigures
from sfgs_jax.evaluation.images._image_evaluation import evaluate_images as evaluate_images
from sfgs_jax.evaluation.images._image_metrics import PROTOCOLS as PROTOCOLS
from sfgs_jax.evaluation.images._image_metrics import SPLATAM_EVERY as SPLATAM_EVERY
from sfgs_jax.evaluation.images._image_metrics import Protocol as Protocol
from sfgs_jax.evaluation.images._image_metrics import frames_of as frames_of
from sfgs_jax.evaluation.images._image_metrics import masked_images as masked_images
from sfgs_jax.evaluation.images._image_metrics import psnr as psnr
from sfgs_jax.evaluation.images._image_metrics import psnr_by_protocol as psnr_by_protocol
from sfgs_jax.evaluation.images._image_metrics import ssim_by_protocol as ssim_by_protocol
from sfgs_jax.evaluation.images._lpips import LpipsWeights as LpipsWeights
from sfgs_jax.evaluation.images._lpips import default_lpips_path as default_lpips_path
from sfgs_jax.evaluation.images._lpips import feature_distance as feature_distance
from sfgs_jax.evaluation.images._lpips import load_lpips as load_lpips
from sfgs_jax.evaluation.images._lpips import lpips as lpips
from sfgs_jax.evaluation.images._lpips import max_pool as max_pool
from sfgs_jax.evaluation.images._lpips import unit_length as unit_length
from sfgs_jax.evaluation.images._map_renderer import MapRenderer as MapRenderer
