"""Calibrate a focal length by the gradient through tracking.

The camera is believed to have a focal length 5 % too long, which turns and shifts every pose that is found.
Between two frames the true motion is known. The derivative of the pose by the intrinsics, through keypoints,
depth and registration, gives Gauss-Newton steps to the focal length at which tracking finds that motion.

    python examples/06_gradient_through_tracking.py [PICTURE.svg]
"""

import sys
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from sfgs_jax import datasets, gicp, slam
from sfgs_jax.geometry import se3


def main(width: int = 160, height: int = 120, steps: int = 5, picture: str | None = None) -> dict[str, float]:
    recording = datasets.SyntheticRecording(num_frames=120, width=width, height=height)
    poses, ends = recording.ground_truth.poses, (0, 4)
    truth = se3.from_matrix(np.linalg.inv(poses[ends[0]]) @ poses[ends[1]])
    frames = [recording[i] for i in ends]
    rgb, depth = (jnp.asarray([getattr(f, name) for f in frames]) for name in ("rgb", "depth"))
    elapsed = jnp.asarray([0.0, frames[1].timestamp - frames[0].timestamp])
    # For small images one resolution is enough, and it compiles sooner.
    tracking = slam.TrackingConfig(gicp=gicp.GicpConfig(levels=1, skipped_halvings=0))
    params = slam.tracker_params(recording.camera, tracking)
    tracker = slam.init_tracker(params)

    def error(scale):
        """Tangent (6,) from the true motion to the tracked one, with the focal length scaled."""
        camera = replace(recording.camera, fx=scale * recording.camera.fx, fy=scale * recording.camera.fy)
        scaled = replace(params, camera=camera)

        def one_frame(tracker, frame):
            tracker, info = slam.track(scaled, tracker, *frame)
            return tracker, info.T_world_cam

        _, found = jax.lax.scan(one_frame, tracker, (rgb, depth, elapsed))
        return se3.log(se3.compose(se3.inverse(truth), jax.tree.map(lambda x: x[-1], found)))

    error_and_slope = jax.jit(lambda scale: jax.jvp(error, (scale,), (jnp.ones(()),)))
    scale = first = jnp.float32(1.05)
    scales = [float(first)]
    for step in range(steps):
        off, slope = error_and_slope(scale)
        print(f"step {step}: focal length x {scale:.4f}, pose {1000 * jnp.linalg.norm(off[:3]):.1f} mm off")
        scale = scale - slope @ off / (slope @ slope)
        scales.append(float(scale))
    print(f"after {steps} steps: focal length x {scale:.4f}")
    if picture is not None:
        figure = Figure(figsize=(6, 3), layout="constrained")
        axes = figure.subplots()
        axes.plot(scales, "o-", color="#2563eb")
        axes.axhline(1, color="#94a3b8")
        axes.set(xlabel="step", ylabel="focal length / true one", xticks=range(steps + 1))
        figure.savefig(picture)
    return {"first_error": abs(float(first) - 1), "last_error": abs(float(scale) - 1)}


if __name__ == "__main__":
    main(picture=sys.argv[1] if len(sys.argv) > 1 else None)
