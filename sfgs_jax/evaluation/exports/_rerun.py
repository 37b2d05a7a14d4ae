"""A run as one file for the viewer of rerun: map, path, and each frame's camera with its images."""

from pathlib import Path

import numpy as np

from sfgs_jax.arrays import InputError, checked
from sfgs_jax.datasets import Recording
from sfgs_jax.evaluation._run_folder import PosedFrames
from sfgs_jax.evaluation.exports._posed_images import encoded_colour, posed_images
from sfgs_jax.geometry import quaternions_from_rotations
from sfgs_jax.splatting import Gaussians, coloured_points

_NAME = "sfgs_jax"


@checked
def write_rerun(path: Path, recording: Recording, posed: PosedFrames, gaussians: Gaussians) -> int:
    """Write a run as an .rrd file, which `rerun FILE` shows along the frames' time.

    `world/map` holds the centres of the Gaussians, `world/path` the positions, and `world/camera` the pose of
    each frame, with its colour as JPEG and its depth below it. It needs `pip install 'sfgs-jax[rerun]'`.

    Args:
        path: the file.
        recording: the recording of the run.
        posed: its frames with a pose.
        gaussians: the map.

    Returns:
        Number of frames written.

    Raises:
        InputError: rerun is not installed.
    """
    try:
        import rerun as rr
    except ImportError as error:
        raise InputError(f"{path} needs rerun: pip install 'sfgs-jax[rerun]'.") from error
    stream = rr.RecordingStream(_NAME, recording_id=recording.name)
    stream.save(str(path))
    stream.log("world", rr.ViewCoordinates.RDF, static=True)
    centres, rgb = coloured_points(gaussians)
    stream.log("world/map", rr.Points3D(centres, colors=rgb), static=True)
    stream.log("world/path", rr.LineStrips3D([posed.poses[:, :3, 3]]), static=True)
    camera = recording.camera
    stream.log(
        "world/camera/image",
        rr.Pinhole(
            image_from_camera=np.asarray(camera.matrix()),
            resolution=[camera.width, camera.height],
            camera_xyz=rr.ViewCoordinates.RDF,
        ),
        static=True,
    )
    count = 0
    for _, frame, pose in posed_images(recording, posed):
        count += 1
        stream.set_time("frame", duration=float(frame.timestamp) - float(recording.timestamps[0]))
        xyzw = quaternions_from_rotations(pose[None, :3, :3])[0][[1, 2, 3, 0]]
        stream.log(
            "world/camera",
            rr.Transform3D(translation=pose[:3, 3], quaternion=rr.Quaternion(xyzw=xyzw)),
        )
        jpeg = encoded_colour(frame, ".jpg")
        stream.log("world/camera/image", rr.EncodedImage(contents=jpeg, media_type="image/jpeg"))
        stream.log("world/camera/image/depth", rr.DepthImage(np.asarray(frame.depth), meter=1.0))
    stream.disconnect()
    return count
