"""The SLAM system: three compiled steps, the host's order of things, and the driver over a recording.

Users need the names of this package. Its folders export the pieces for those who compose their own system.
"""

from sfgs_jax.slam._graph_results import finish as finish
from sfgs_jax.slam._init import init as init
from sfgs_jax.slam._presets import PRESETS as PRESETS
from sfgs_jax.slam.config import FeaturesConfig as FeaturesConfig
from sfgs_jax.slam.config import GraphConfig as GraphConfig
from sfgs_jax.slam.config import LearningRates as LearningRates
from sfgs_jax.slam.config import MappingConfig as MappingConfig
from sfgs_jax.slam.config import OptimisationConfig as OptimisationConfig
from sfgs_jax.slam.config import SeedingConfig as SeedingConfig
from sfgs_jax.slam.config import SlamConfig as SlamConfig
from sfgs_jax.slam.config import TrackingConfig as TrackingConfig
from sfgs_jax.slam.frontend import TrackInfo as TrackInfo
from sfgs_jax.slam.frontend import estimated_timing as estimated_timing
from sfgs_jax.slam.frontend import init_tracker as init_tracker
from sfgs_jax.slam.frontend import observe as observe
from sfgs_jax.slam.frontend import register as register
from sfgs_jax.slam.frontend import track as track
from sfgs_jax.slam.frontend import tracker_params as tracker_params
from sfgs_jax.slam.keyframes import Adjusted as Adjusted
from sfgs_jax.slam.keyframes import Window as Window
from sfgs_jax.slam.keyframes import adjust as adjust
from sfgs_jax.slam.keyframes import estimated_depth as estimated_depth
from sfgs_jax.slam.keyframes import window_of as window_of
from sfgs_jax.slam.mapping import MapParams as MapParams
from sfgs_jax.slam.mapping import map_step as map_step
from sfgs_jax.slam.run import OUTPUT_FILES as OUTPUT_FILES
from sfgs_jax.slam.run import STORAGE as STORAGE
from sfgs_jax.slam.run import Progress as Progress
from sfgs_jax.slam.run import Run as Run
from sfgs_jax.slam.run import Stopwatch as Stopwatch
from sfgs_jax.slam.run import TooManySkipped as TooManySkipped
from sfgs_jax.slam.run import load as load
from sfgs_jax.slam.run import load_run as load_run
from sfgs_jax.slam.run import prepare_folder as prepare_folder
from sfgs_jax.slam.run import run as run
from sfgs_jax.slam.run import save as save
from sfgs_jax.slam.run import save_run as save_run
from sfgs_jax.slam.run import warm_up as warm_up
from sfgs_jax.slam.run import write_run as write_run
from sfgs_jax.slam.run import write_trajectories as write_trajectories
from sfgs_jax.slam.state import FrameFeatures as FrameFeatures
from sfgs_jax.slam.state import Keyframe as Keyframe
from sfgs_jax.slam.state import KeyframeGraph as KeyframeGraph
from sfgs_jax.slam.state import PoseSource as PoseSource
from sfgs_jax.slam.state import Registration as Registration
from sfgs_jax.slam.state import SlamState as SlamState
from sfgs_jax.slam.state import StepInfo as StepInfo
from sfgs_jax.slam.state import Tracker as Tracker
from sfgs_jax.slam.state import TrackerParams as TrackerParams
from sfgs_jax.slam.state import View as View
from sfgs_jax.slam.step import Followed as Followed
from sfgs_jax.slam.step import follow as follow
from sfgs_jax.slam.step import step as step
