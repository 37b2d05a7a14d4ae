"""transforms.json of nerfstudio and instant-ngp, with the images and the map's points beside it.

Source: nerfstudio's page on data conventions; instant-ngp's page on its NeRF dataset format.
"""

import json
import math
from pathlib import Path

import numpy as np

from sfgs_jax.arrays import checked, write_atomically
from sfgs_jax.datasets import Recording
from sfgs_jax.datasets.files import opencv_poses
from sfgs_jax.evaluation._run_folder import PosedFrames
from sfgs_jax.evaluation.exports._posed_images import (
    UNITS_PER_METRE,
    written_images,
)
from sfgs_jax.splatting import Gaussians, save_points

_POINTS = "points.ply"


@checked
def write_nerfstudio(path: Path, recording: Recording, posed: PosedFrames, gaussians: Gaussians) -> int:
    """Write a run as nerfstudio and instant-ngp read it.

    Camera axes are OpenGL's and the principal point counts from the first pixel's corner, as both expect. The
    names of the images are relative. `points.ply` holds the centres of the map's Gaussians, which splatfacto
    begins with.

    Args:
        path: folder, made if it is not there.
        recording: the recording of the run.
        posed: its frames with a pose.
        gaussians: the map.

    Returns:
        Number of frames written.

    Raises:
        InputError: the folder is not empty.
        OSError: a file can't be written.
    """
    frames = []
    for name, frame, pose in written_images(path, recording, posed):
        # The same half turn takes either program's camera axes to the other's.
        matrix = opencv_poses(np.asarray(pose)[None])[0]
        entry = {
            "file_path": f"images/{name}",
            "depth_file_path": f"depth/{name}",
            "timestamp": float(frame.timestamp),
            "transform_matrix": matrix.tolist(),
        }
        frames.append(entry)
    camera = recording.camera
    fx, fy = float(camera.fx), float(camera.fy)
    content = {
        "camera_model": "OPENCV",
        "fl_x": fx,
        "fl_y": fy,
        "cx": float(camera.cx) + 0.5,
        "cy": float(camera.cy) + 0.5,
        "w": camera.width,
        "h": camera.height,
        "camera_angle_x": 2 * math.atan(camera.width / 2 / fx),
        "camera_angle_y": 2 * math.atan(camera.height / 2 / fy),
        "integer_depth_scale": 1 / UNITS_PER_METRE,
        "ply_file_path": _POINTS,
        "frames": frames,
    }
    save_points(path / _POINTS, gaussians)
    write_atomically(path / "transforms.json", json.dumps(content, indent=2) + "\n")
    return len(frames)
