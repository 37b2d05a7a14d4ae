"""Track several recordings at once, as one compiled program.

`slam.track` is a pure function on arrays of fixed shapes. So a recording is a `lax.scan` over its frames, and
a batch of recordings is a `vmap` of that scan. This is tracking alone: no keyframe graph, no map.

    python examples/05_scan_and_vmap.py
"""

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np

from sfgs_jax import datasets, gicp, slam
from sfgs_jax.evaluation import ate
from sfgs_jax.geometry import Trajectory, se3


@jax.jit
def trajectories(params, tracker, rgb, depth, elapsed):
    """Poses (B, N, 7) as wxyz_xyz, and which are known, of B recordings of N frames."""

    def one_recording(rgb, depth, elapsed):
        def one_frame(tracker, frame):
            tracker, info = slam.track(params, tracker, *frame)
            return tracker, (info.T_world_cam.wxyz_xyz, info.tracked)

        return jax.lax.scan(one_frame, tracker, (rgb, depth, elapsed))[1]

    return jax.vmap(one_recording)(rgb, depth, elapsed)


def main(width: int = 160, height: int = 120, frames: int = 20, batch: int = 3) -> dict[str, float]:
    recordings = [
        datasets.SyntheticRecording(num_frames=3 * frames, width=width, height=height, seed=seed, noise=True)
        for seed in range(batch)
    ]
    taken = [[recording[i] for i in range(frames)] for recording in recordings]
    rgb = jnp.asarray([[frame.rgb for frame in row] for row in taken])
    depth = jnp.asarray([[frame.depth for frame in row] for row in taken])
    times = np.asarray([[frame.timestamp for frame in row] for row in taken])
    elapsed = jnp.asarray(np.diff(times, axis=1, prepend=times[:, :1]), jnp.float32)  # 0 for the first

    # Small images need fewer resolutions, and fewer compile sooner.
    tracking = slam.TrackingConfig(gicp=gicp.GicpConfig(levels=1))
    params = slam.tracker_params(recordings[0].camera, tracking)
    poses, tracked = trajectories(params, slam.init_tracker(params), rgb, depth, elapsed)

    errors = []
    for recording, row, seconds in zip(recordings, poses, times, strict=True):
        estimate = Trajectory(seconds, se3.to_matrices(jaxlie.SE3(row)))
        errors.append(100 * ate(estimate, recording.ground_truth).rmse_m)
    print(f"{int(tracked.sum())} of {batch * frames} frames of {batch} recordings tracked")
    print("trajectory errors (RMSE): " + ", ".join(f"{error:.2f} cm" for error in errors))
    return {"tracked": float(tracked.mean()), "worst_cm": max(errors)}


if __name__ == "__main__":
    main()
