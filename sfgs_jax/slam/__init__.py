"""The SLAM system: pure steps on one state, and the driver that runs them over a recording."""

from sfgs_jax.slam.config import LearningRates as LearningRates
from sfgs_jax.slam.config import MappingConfig as MappingConfig
from sfgs_jax.slam.config import OptimisationConfig as OptimisationConfig
from sfgs_jax.slam.config import SeedingConfig as SeedingConfig
from sfgs_jax.slam.config import SlamConfig as SlamConfig
from sfgs_jax.slam.config import TrackingConfig as TrackingConfig
from sfgs_jax.slam.driver import Progress as Progress
from sfgs_jax.slam.driver import Run as Run
from sfgs_jax.slam.driver import TooManySkipped as TooManySkipped
from sfgs_jax.slam.driver import run as run
from sfgs_jax.slam.outputs import OUTPUT_FILES as OUTPUT_FILES
from sfgs_jax.slam.outputs import prepare_folder as prepare_folder
from sfgs_jax.slam.outputs import write_run as write_run
from sfgs_jax.slam.outputs import write_trajectories as write_trajectories
from sfgs_jax.slam.presets import PRESETS as PRESETS
from sfgs_jax.slam.state import Keyframe as Keyframe
from sfgs_jax.slam.state import SlamState as SlamState
from sfgs_jax.slam.state import init as init
from sfgs_jax.slam.step import StepInfo as StepInfo
from sfgs_jax.slam.step import step as step
