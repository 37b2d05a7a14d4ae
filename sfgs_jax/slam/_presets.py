"""Settings that suit each kind of recording; every one can be overridden on the command line."""

from sfgs_jax.slam.config import MappingConfig, SeedingConfig, SlamConfig, TrackingConfig

_KINECT = SlamConfig(
    tracking=TrackingConfig(estimate_timing=True, estimate_depth=True, estimate_extrinsic=True),
    mapping=MappingConfig(seeding=SeedingConfig(max_depth=5.0)),
)
"""A Kinect's depth is noise beyond five metres or so, and distorted. Its rows are not exposed at once
(`experiments.sensors`)."""

PRESETS: dict[str, SlamConfig] = {
    "tum": _KINECT,
    "7scenes": _KINECT,
    "scannet": _KINECT,
    "replica": SlamConfig(),
    "icl_nuim": SlamConfig(),
    "stray": SlamConfig(),
    "record3d": SlamConfig(),
    "nerfstudio": SlamConfig(),
    "colmap": SlamConfig(),
    "open3d": SlamConfig(),
    "euroc": SlamConfig(),
    "scannetpp": SlamConfig(),
    "rosbag": SlamConfig(),
    "video": SlamConfig(),
    "folder": SlamConfig(),
    "synthetic": SlamConfig(),
}
"""Preset by dataset name."""
