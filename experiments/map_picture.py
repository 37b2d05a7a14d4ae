"""A picture of a run's map beside its input: two frames with their renderings, and a view of the whole.

    python -m experiments.map_picture RUN RECORDING [--frames 228 276] [--from 168] [--out FILE]

The last column is seen from where the camera never was: behind and above the pose of the frame `--from`.
What no depth image showed stays empty there. Written as JPEG.
"""

import argparse
from pathlib import Path

import cv2
import jax.numpy as jnp
import jaxlie
import numpy as np

from sfgs_jax.datasets import Recording, open_recording
from sfgs_jax.geometry import Camera, Trajectory, read_tum, se3
from sfgs_jax.splatting import Gaussians, RenderConfig, load_ply, pair_capacity, render

WIDTH, HEIGHT, GAP, BAND = 320, 240, 8, 26
EMPTY = (0.78, 0.82, 0.86)
"""Colour where the map has nothing, in the view of the whole."""


def drawn(gaussians: Gaussians, camera: Camera, T_world_cam: jaxlie.SE3, empty: tuple) -> np.ndarray:
    config = RenderConfig(pair_capacity=pair_capacity(gaussians, camera, T_world_cam))
    out = render(gaussians, camera, T_world_cam, jnp.asarray(empty), config=config)
    return np.clip(np.asarray(out.rgb), 0, 1)


def beside(
    recording: Recording, trajectory: Trajectory, gaussians: Gaussians, number: int
) -> tuple[np.ndarray, np.ndarray]:
    """A recorded frame and the map from its pose, both at mapping resolution."""
    index = int(np.argmin(np.abs(recording.timestamps - trajectory.timestamps[number])))
    factor = -(-recording.camera.width // WIDTH)
    camera = recording.camera.downscaled(factor)
    frame = cv2.resize(
        np.asarray(recording[index].rgb), (camera.width, camera.height), interpolation=cv2.INTER_AREA
    )
    pose = se3.from_matrix(trajectory.poses[number])
    return frame, drawn(gaussians, camera, pose, (0.0, 0.0, 0.0))


def whole(trajectory: Trajectory, gaussians: Gaussians, number: int) -> np.ndarray:
    """The map from behind and above a pose."""
    back = se3.compose(
        se3.exp(jnp.asarray([0.0, -0.4, -0.9, 0.0, 0.0, 0.0])),
        se3.exp(jnp.asarray([0.0, 0.0, 0.0, -0.2, 0.0, 0.0])),
    )
    size = 2 * HEIGHT + BAND + GAP
    camera = Camera(0.62 * size, 0.62 * size, size / 2, size / 2, width=size, height=size)
    pose = se3.compose(se3.from_matrix(trajectory.poses[number]), back)
    return drawn(gaussians, camera, pose, EMPTY)


def captioned(image: np.ndarray, text: str) -> np.ndarray:
    """An image in 8 bits under a line of text."""
    band = np.full((BAND, image.shape[1], 3), 255, np.uint8)
    cv2.putText(band, text, (4, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (50, 50, 50), 1, cv2.LINE_AA)
    return np.concatenate([band, np.round(255 * image).astype(np.uint8)], axis=0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("run", type=Path, help="folder of the run")
    parser.add_argument("recording", help="what the run was made from")
    parser.add_argument("--frames", type=int, nargs=2, default=(228, 276), help="lines of trajectory.txt")
    parser.add_argument("--from", type=int, default=168, dest="start", help="line of trajectory.txt")
    parser.add_argument("--out", type=Path, default=Path("docs/images/map.jpg"))
    arguments = parser.parse_args()
    recording = open_recording(arguments.recording)
    trajectory = read_tum(arguments.run / "trajectory.txt")
    gaussians = load_ply(arguments.run / "map.ply")

    pairs = [beside(recording, trajectory, gaussians, number) for number in arguments.frames]
    labels = ("recorded", "rendered from the map")
    columns = [
        np.concatenate([captioned(image, label) for image, label in zip(pair, labels, strict=True)])
        for pair in pairs
    ]
    overview = captioned(whole(trajectory, gaussians, arguments.start), "the map from behind the camera")
    columns.append(overview[: columns[0].shape[0]])
    gap = np.full((columns[0].shape[0], GAP, 3), 255, np.uint8)
    row = np.concatenate([columns[0], gap, columns[1], gap, columns[2]], axis=1)
    quality = [cv2.IMWRITE_JPEG_QUALITY, 88]
    cv2.imwrite(str(arguments.out), row[..., ::-1], quality)


if __name__ == "__main__":
    main()
