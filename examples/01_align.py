"""Align two depth images with GICP, and say how certain the motion is.

The two frames are five apart in a synthetic recording with the noise of a Kinect, whose exact poses tell the
error. The inverse of the information matrix is the covariance of the motion.

    python examples/01_align.py [PICTURE.png]
"""

import sys

import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from sfgs_jax import datasets, gicp
from sfgs_jax.geometry import se3, surface


def main(width: int = 320, height: int = 240, picture: str | None = None) -> dict[str, float]:
    recording = datasets.SyntheticRecording(num_frames=120, width=width, height=height, noise=True)
    poses = recording.ground_truth.poses
    a, b = 0, 5

    target = gicp.prepare(recording[a].depth, recording.camera)
    source = gicp.prepare(recording[b].depth, recording.camera)
    result = gicp.align(source, target, se3.identity())

    truth = se3.from_matrix(np.linalg.inv(poses[a]) @ poses[b])
    error = se3.log(se3.compose(se3.inverse(truth), result.T_target_source))  # translation first
    moved = float(jnp.linalg.norm(se3.log(truth)[:3]))
    off_cm = 100 * float(jnp.linalg.norm(error[:3]))
    off_deg = float(jnp.rad2deg(jnp.linalg.norm(error[3:])))
    covariance = jnp.linalg.inv(result.information)
    sigma_cm = 100 * float(jnp.sqrt(jnp.max(jnp.linalg.eigvalsh(covariance[:3, :3]))))

    print(f"the camera moved by {100 * moved:.1f} cm; converged: {bool(result.converged)}")
    print(f"{result.inlier_fraction:.0%} of the points lie on the target, to {1000 * result.rmse:.1f} mm")
    print(f"error {off_cm:.2f} cm and {off_deg:.3f} degrees")
    print(f"by its covariance {sigma_cm:.2f} cm in the least certain direction")
    if picture is not None:  # both clouds from above, before and after
        points = [surface(recording[i].depth, recording.camera) for i in (a, b)]
        here, there = (cloud.points[cloud.valid] for cloud in points)
        figure = Figure(figsize=(9, 2.8), layout="constrained")
        moved_there = se3.transform(result.T_target_source, there)
        for axes, cloud, title in zip(
            figure.subplots(1, 2), (there, moved_there), ("before", "after"), strict=True
        ):
            axes.plot(here[:, 0], here[:, 2], ",", color="#2563eb")
            axes.plot(cloud[:, 0], cloud[:, 2], ",", color="#dc2626")
            axes.set(title=title, xlabel="x (m)", ylabel="z (m)", aspect="equal")
        figure.savefig(picture)
    return {
        "moved_cm": 100 * moved,
        "error_cm": off_cm,
        "error_deg": off_deg,
        "sigma_cm": sigma_cm,
        "inlier_fraction": float(result.inlier_fraction),
        "converged": float(result.converged),
    }


if __name__ == "__main__":
    main(picture=sys.argv[1] if len(sys.argv) > 1 else None)
