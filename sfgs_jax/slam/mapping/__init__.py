"""The Gaussian map at work: views, seeding, map steps, and the thread that does them."""

from sfgs_jax.slam.mapping._joining import joined_views as joined_views
from sfgs_jax.slam.mapping._joining import with_lacking_gaussians as with_lacking_gaussians
from sfgs_jax.slam.mapping._map_step import MapParams as MapParams
from sfgs_jax.slam.mapping._map_step import MapStep as MapStep
from sfgs_jax.slam.mapping._map_step import map_step as map_step
from sfgs_jax.slam.mapping._map_step import mapping_loss as mapping_loss
from sfgs_jax.slam.mapping._map_step import prune as prune
from sfgs_jax.slam.mapping._map_update import compile_ahead as compile_ahead
from sfgs_jax.slam.mapping._map_update import follow_keyframes as follow_keyframes
from sfgs_jax.slam.mapping._map_update import follow_trajectory as follow_trajectory
from sfgs_jax.slam.mapping._map_update import insert_view as insert_view
from sfgs_jax.slam.mapping._map_update import map_frame as map_frame
from sfgs_jax.slam.mapping._map_update import optimise_once as optimise_once
from sfgs_jax.slam.mapping._map_update import step_on_view as step_on_view
from sfgs_jax.slam.mapping._map_worker import MAX_KEYFRAMES_WAITING as MAX_KEYFRAMES_WAITING
from sfgs_jax.slam.mapping._map_worker import InlineMapWorker as InlineMapWorker
from sfgs_jax.slam.mapping._map_worker import MapWorker as MapWorker
from sfgs_jax.slam.mapping._map_worker import ThreadedMapWorker as ThreadedMapWorker
from sfgs_jax.slam.mapping._refinement import prepare_refinement as prepare_refinement
from sfgs_jax.slam.mapping._refinement import refine_once as refine_once
from sfgs_jax.slam.mapping._seeding import seed as seed
from sfgs_jax.slam.mapping._seeding import uncovered as uncovered
from sfgs_jax.slam.mapping._view_choice import becomes_view as becomes_view
from sfgs_jax.slam.mapping._view_choice import image_shift as image_shift
from sfgs_jax.slam.mapping._view_choice import view_is_due as view_is_due
from sfgs_jax.slam.mapping._view_choice import view_of as view_of
