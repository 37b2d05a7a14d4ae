"""COLMAP's sparse model as text: cameras, images, and the map's centres as points.

Source: COLMAP's page on its output format. Poses are world to camera, principal points count from the corner
of the first pixel.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import checked, write_atomically
from sfgs_jax.datasets import Recording
from sfgs_jax.evaluation._run_folder import PosedFrames
from sfgs_jax.evaluation.exports._posed_images import written_images
from sfgs_jax.geometry import Camera, quaternions_from_rotations
from sfgs_jax.splatting import Gaussians, coloured_points


@checked
def write_colmap(path: Path, recording: Recording, posed: PosedFrames, gaussians: Gaussians) -> int:
    """Write a run as programs read it that begin with COLMAP's model: 3DGS, gsplat, nerfstudio.

    The model is in `sparse/0`, the images in `images`, depth in millimetres in `depth`. The points are the
    centres of the map's Gaussians; they have no tracks.

    Args:
        path: folder, made if it is not there.
        recording: the recording of the run.
        posed: its frames with a pose.
        gaussians: the map.

    Returns:
        Number of images written.

    Raises:
        InputError: the folder is not empty.
        OSError: a file can't be written.
    """
    lines = ["# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then a line of points"]
    count = 0
    for name, _, pose in written_images(path, recording, posed):
        count += 1
        lines += [f"{count} {_world_to_camera(pose)} 1 {name}", ""]
    model = path / "sparse" / "0"
    model.mkdir(parents=True)
    write_atomically(model / "cameras.txt", _cameras(recording.camera))
    write_atomically(model / "images.txt", "\n".join(lines) + "\n")
    write_atomically(model / "points3D.txt", _points(gaussians))
    return count


def _world_to_camera(T_world_cam: Float[np.ndarray, "4 4"]) -> str:
    T = np.linalg.inv(np.asarray(T_world_cam, np.float64))
    wxyz = quaternions_from_rotations(T[None, :3, :3])[0]
    return " ".join(f"{value:.12g}" for value in (*wxyz, *T[:3, 3]))


def _cameras(camera: Camera) -> str:
    numbers = float(camera.fx), float(camera.fy), float(camera.cx) + 0.5, float(camera.cy) + 0.5
    parameters = " ".join(f"{number:.12g}" for number in numbers)
    return f"# CAMERA_ID MODEL WIDTH HEIGHT PARAMS\n1 PINHOLE {camera.width} {camera.height} {parameters}\n"


def _points(gaussians: Gaussians) -> str:
    centres, rgb = coloured_points(gaussians)
    rows = zip(centres.tolist(), rgb.tolist(), strict=True)
    lines = [
        f"{number} {x:.6g} {y:.6g} {z:.6g} {r} {g} {b} 0"
        for number, ((x, y, z), (r, g, b)) in enumerate(rows, 1)
    ]
    return "\n".join(["# POINT3D_ID X Y Z R G B ERROR TRACK", *lines]) + "\n"
