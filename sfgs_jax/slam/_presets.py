"""Settings that suit each kind of recording; every one can be overridden on the command line."""

from sfgs_jax.slam.config import MappingConfig, SeedingConfig, SlamConfig

_KINECT = SlamConfig(mapping=MappingConfig(seeding=SeedingConfig(max_depth=5.0)))
"""A Kinect's depth is noise beyond five metres or so."""

PRESETS: dict[str, SlamConfig] = {
    "tum": _KINECT,
    "7scenes": _KINECT,
    "scannet": _KINECT,
    "replica": SlamConfig(),
    "icl_nuim": SlamConfig(),
    "folder": SlamConfig(),
    "synthetic": SlamConfig(mapping=MappingConfig(seeding=SeedingConfig(stride=3))),
}
"""Preset by dataset name."""
