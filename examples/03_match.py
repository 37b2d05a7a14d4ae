"""Match keypoints of two frames, and find the camera's motion from them.

Keypoints get their depth from the depth images, so matched keypoints are matched points in space. Graduated
non-convexity finds the rigid motion between them and leaves wrong matches out.

    python examples/03_match.py
"""

import jax.numpy as jnp
import numpy as np

from sfgs_jax import datasets, gicp, superfeats
from sfgs_jax.geometry import se3


def points_at(pixels, depth, camera):
    """Points in camera coordinates under pixels, and which of them have depth."""
    column, row = np.round(np.asarray(pixels)).astype(int).T
    z = jnp.asarray(depth[row, column])
    x, y = (pixels[:, 0] - camera.cx) / camera.fx, (pixels[:, 1] - camera.cy) / camera.fy
    return jnp.stack([x * z, y * z, z], axis=1), z > 0


def main(width: int = 320, height: int = 240) -> dict[str, float]:
    recording = datasets.SyntheticRecording(num_frames=120, width=width, height=height, noise=True)
    camera, poses = recording.camera, recording.ground_truth.poses
    target, source = recording[0], recording[8]

    params = superfeats.load_weights()
    a = superfeats.extract(params, source.rgb, max_keypoints=512)
    b = superfeats.extract(params, target.rgb, max_keypoints=512)
    matches = superfeats.filter_by_motion(a, b, superfeats.match(a, b))

    source_points, has_source = points_at(a.keypoints, source.depth, camera)
    target_points, has_target = points_at(b.keypoints[matches.index_b], target.depth, camera)
    usable = matches.valid & has_source & has_target
    found = gicp.rigid_from_matches(source_points, target_points, valid=usable)

    truth = se3.from_matrix(np.linalg.inv(poses[0]) @ poses[8])
    error = se3.log(se3.compose(se3.inverse(truth), found.T_target_source))
    moved = float(jnp.linalg.norm(se3.log(truth)[:3]))
    off_cm = 100 * float(jnp.linalg.norm(error[:3]))
    off_deg = float(jnp.rad2deg(jnp.linalg.norm(error[3:])))
    print(f"{int(matches.valid.sum())} matches, {int(found.num_inliers)} agree with one motion")
    print(f"the camera moved by {100 * moved:.1f} cm; error {off_cm:.2f} cm and {off_deg:.3f} degrees")
    return {
        "matches": float(matches.valid.sum()),
        "inliers": float(found.num_inliers),
        "moved_cm": 100 * moved,
        "error_cm": off_cm,
        "error_deg": off_deg,
    }


if __name__ == "__main__":
    main()
