"""Videos of a path through a map."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import poses_at
from sfgs_jax.geometry import Trajectory

FRAMES_PER_S = 30


def path_in_time(trajectory: Trajectory, speed: float) -> Float[np.ndarray, "n 4 4"]:
    """Poses of a path for the frames of a video, by the recording's clock.

    Args:
        trajectory: the path, at least one pose.
        speed: seconds of the recording per second of the video.
    """
    first, last = trajectory.timestamps[0], trajectory.timestamps[-1]
    count = int((last - first) / speed * FRAMES_PER_S) + 1
    times = first + np.arange(count) * (speed / FRAMES_PER_S)
    return poses_at(trajectory, np.minimum(times, last), np.inf)[0].poses


def write_video(
    path: Path,
    poses: Float[np.ndarray, "n 4 4"],
    paint: Callable[[Float[np.ndarray, "4 4"]], UInt8[np.ndarray, "H W 3"]],
    *,
    progress: Callable[[int], bool],
) -> bool:
    """Write an MP4 file, MPEG-4 part 2, of images from one pose after the other.

    Args:
        path: the file; one that exists is replaced.
        poses: of the camera, one a frame.
        paint: makes the image of a pose; all have the same size.
        progress: told the number of frames that are done; it answers whether to go on.

    Returns:
        Whether it went to the end; a file that did not is removed.

    Raises:
        InputError: the file can't be written.
    """
    first = paint(poses[0])
    height, width = first.shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), FRAMES_PER_S, (width, height))
    if not writer.isOpened():
        raise InputError(f"OpenCV can't write the video {path} of {width} x {height} pixels.")
    try:
        for done, pose in enumerate(poses, start=1):
            image = first if done == 1 else paint(pose)
            writer.write(np.ascontiguousarray(image[..., ::-1]))
            if not progress(done):
                break
        else:
            return True
    finally:
        writer.release()
    path.unlink(missing_ok=True)
    return False
