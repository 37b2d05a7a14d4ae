"""Track one recording under several focal lengths at once, shared out over all devices.

A batch is a `vmap` of `slam.track_sequence`, here over parameters. An array that a `NamedSharding`
splits makes XLA run the same program on each device, with its share of the batch. CPU devices can be virtual:

    XLA_FLAGS=--xla_force_host_platform_device_count=8 python examples/07_batch_over_devices.py
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from sfgs_jax import datasets, gicp, slam


def main(width: int = 160, height: int = 120, batch: int = 8) -> dict[str, float]:
    recording = datasets.SyntheticRecording(num_frames=60, width=width, height=height)
    frames = [recording[0], recording[3]]
    rgb, depth = (jnp.asarray([getattr(frame, name) for frame in frames]) for name in ("rgb", "depth"))
    # The surface alone gives so small a motion, and without keypoints the program compiles sooner.
    surface = gicp.GicpConfig(levels=1, skipped_halvings=0)
    tracking = slam.TrackingConfig(features=slam.FeaturesConfig(kind="none"), gicp=surface)
    params = slam.tracker_params(recording.camera, tracking)
    tracker = slam.init_tracker(params)

    @jax.jit
    @jax.vmap
    def last_pose(scale):
        """Pose of the second frame as wxyz_xyz, with the focal length scaled."""
        camera = replace(recording.camera, fx=scale * recording.camera.fx, fy=scale * recording.camera.fy)
        scaled, elapsed = replace(params, camera=camera), jnp.full(2, 0.1)
        _, found = slam.track_sequence(scaled, tracker, rgb, depth, elapsed)
        return found.T_world_cam.wxyz_xyz[-1]

    scales = jnp.linspace(0.95, 1.05, batch)
    split = NamedSharding(Mesh(np.asarray(jax.devices()), ("batch",)), PartitionSpec("batch"))
    shared = last_pose(jax.device_put(scales, split))
    alone = last_pose(jax.device_put(scales, jax.devices()[0]))
    used = len(shared.sharding.device_set)
    difference = float(jnp.abs(np.asarray(shared) - np.asarray(alone)).max())
    print(f"{batch} focal lengths on {used} devices; largest difference from one device: {difference:.1e}")
    return {
        "devices": used,
        "difference": difference,
        "spread": float(np.ptp(np.asarray(shared), axis=0).max()),
    }


if __name__ == "__main__":
    main()
