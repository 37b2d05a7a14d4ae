"""Settings of the SLAM system: frozen dataclasses that check themselves."""

from sfgs_jax.slam.config._graph import GraphConfig as GraphConfig
from sfgs_jax.slam.config._mapping import LearningRates as LearningRates
from sfgs_jax.slam.config._mapping import MappingConfig as MappingConfig
from sfgs_jax.slam.config._mapping import OptimisationConfig as OptimisationConfig
from sfgs_jax.slam.config._mapping import PagingConfig as PagingConfig
from sfgs_jax.slam.config._mapping import SeedingConfig as SeedingConfig
from sfgs_jax.slam.config._slam import SlamConfig as SlamConfig
from sfgs_jax.slam.config._tracking import FeaturesConfig as FeaturesConfig
from sfgs_jax.slam.config._tracking import TrackingConfig as TrackingConfig
