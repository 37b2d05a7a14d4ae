"""Training of SuperFeats: augmentation of views, losses, training steps. Needs optax."""

from sfgs_jax.superfeats._descriptors import sample as sample
from sfgs_jax.superfeats._descriptors import unit as unit
from sfgs_jax.superfeats.training._augmentation import ViewConfig as ViewConfig
from sfgs_jax.superfeats.training._augmentation import motion_blur as motion_blur
from sfgs_jax.superfeats.training._augmentation import occlude as occlude
from sfgs_jax.superfeats.training._augmentation import random_homography as random_homography
from sfgs_jax.superfeats.training._augmentation import relight as relight
from sfgs_jax.superfeats.training._augmentation import warp as warp
from sfgs_jax.superfeats.training._losses import contrastive_keypoint_loss as contrastive_keypoint_loss
from sfgs_jax.superfeats.training._losses import dual_softmax_loss as dual_softmax_loss
from sfgs_jax.superfeats.training._losses import heat_loss as heat_loss
from sfgs_jax.superfeats.training._losses import hinge_descriptor_loss as hinge_descriptor_loss
from sfgs_jax.superfeats.training._losses import imitation_loss as imitation_loss
from sfgs_jax.superfeats.training._losses import keypoint_positions as keypoint_positions
from sfgs_jax.superfeats.training._losses import reliability_loss as reliability_loss
from sfgs_jax.superfeats.training._losses import reprojection_loss as reprojection_loss
from sfgs_jax.superfeats.training._train_step import Batch as Batch
from sfgs_jax.superfeats.training._train_step import LossWeights as LossWeights
from sfgs_jax.superfeats.training._train_step import TrainingState as TrainingState
from sfgs_jax.superfeats.training._train_step import evaluate as evaluate
from sfgs_jax.superfeats.training._train_step import initial_state as initial_state
from sfgs_jax.superfeats.training._train_step import losses as losses
from sfgs_jax.superfeats.training._train_step import train_step as train_step
