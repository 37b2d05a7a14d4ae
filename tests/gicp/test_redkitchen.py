"""Real depth images: errors against the poses given with the recording, themselves good to a centimetre."""

import cv2
import numpy as np

from sfgs_jax.geometry import Camera, se3
from sfgs_jax.gicp import align, prepare
from tests.gicp.scenes import motion_error


def test_redkitchen_neighbours_are_aligned_from_the_identity(sfgs_data):
    folder = sfgs_data / "data" / "7scenes" / "redkitchen"
    camera = Camera(585, 585, 320, 240, width=640, height=480)

    def load(i: int):
        raw = cv2.imread(str(folder / f"frame-{i:06d}.depth.png"), cv2.IMREAD_UNCHANGED)
        assert raw is not None
        depth = np.where(raw == 65535, 0, raw).astype(np.float32) / 1000
        return prepare(depth, camera), np.loadtxt(folder / f"frame-{i:06d}.pose.txt")

    errors = {1: [], 5: []}
    for i in range(0, 560, 40):
        target, T_world_target = load(i)
        for gap, found in errors.items():
            source, T_world_source = load(i + gap)
            result = align(source, target, se3.identity())
            assert result.converged
            assert result.inlier_fraction > 0.5
            given = np.linalg.inv(T_world_target) @ T_world_source
            found.append(motion_error(np.asarray(se3.matrix(result.T_target_source), np.float64), given))
    near, far = (np.median(found, axis=0) for found in errors.values())
    assert near[0] < 0.0025
    assert near[1] < 0.09
    assert far[0] < 0.0060
    assert far[1] < 0.19
