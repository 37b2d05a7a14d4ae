"""A run over a recording: driver, storage, outputs, stopwatch, warm-up."""

from sfgs_jax.slam.run._driver import Observer as Observer
from sfgs_jax.slam.run._driver import Progress as Progress
from sfgs_jax.slam.run._driver import Run as Run
from sfgs_jax.slam.run._driver import TooManySkipped as TooManySkipped
from sfgs_jax.slam.run._driver import combined as combined
from sfgs_jax.slam.run._driver import load_run as load_run
from sfgs_jax.slam.run._driver import run as run
from sfgs_jax.slam.run._driver import save_run as save_run
from sfgs_jax.slam.run._outputs import GROUND_TRUTH_FILE as GROUND_TRUTH_FILE
from sfgs_jax.slam.run._outputs import OUTPUT_FILES as OUTPUT_FILES
from sfgs_jax.slam.run._outputs import STORAGE as STORAGE
from sfgs_jax.slam.run._outputs import prepare_folder as prepare_folder
from sfgs_jax.slam.run._outputs import resume_folder as resume_folder
from sfgs_jax.slam.run._outputs import write_run as write_run
from sfgs_jax.slam.run._outputs import write_trajectories as write_trajectories
from sfgs_jax.slam.run._sensor_file import write_sensors as write_sensors
from sfgs_jax.slam.run._stopwatch import Stopwatch as Stopwatch
from sfgs_jax.slam.run._storage import FORMAT_VERSION as FORMAT_VERSION
from sfgs_jax.slam.run._storage import STATE_FILE as STATE_FILE
from sfgs_jax.slam.run._storage import load as load
from sfgs_jax.slam.run._storage import save as save
from sfgs_jax.slam.run._storage import spill as spill
from sfgs_jax.slam.run._storage import spill_views as spill_views
from sfgs_jax.slam.run._tensor_file import read_tensors as read_tensors
from sfgs_jax.slam.run._tensor_file import write_tensors as write_tensors
from sfgs_jax.slam.run._warm_up import warm_up as warm_up
