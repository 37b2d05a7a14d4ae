"""How far do matched keypoints lie from where they should? As detected, and as their patches place them.

    python -m experiments.keypoint_places [--gaps 2 5]

Synthetic recordings at 320x240 have a truth: it says where a keypoint of one frame lies in another. The
table is of the matches that a registration explains, which starts from the true motion. It has deviations
along both axes by the median, the mean, and the share that is more than 2 pixels off.
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Float

from experiments.matching_tables import print_table
from sfgs_jax.datasets import KinectFaults, SyntheticRecording
from sfgs_jax.geometry import se3
from sfgs_jax.slam import SlamConfig, observe, register, tracker_params

READOUT = 0.03
SOURCES = {
    "room": SyntheticRecording(num_frames=300, noise=True),
    "room, rolling shutter": SyntheticRecording(
        num_frames=300, noise=True, faults=KinectFaults(colour_readout=READOUT)
    ),
    "room, blurred": SyntheticRecording(num_frames=300, noise=True, faults=KinectFaults(exposure_time=0.02)),
    "bare sphere": SyntheticRecording(num_frames=400, noise=True, place="sphere"),
}
COLUMNS = ("recording", "places", "matches", "deviation u, v px", "mean u, v px", "beyond 2 px %")
FAR = 2.0
"""Pixels off that no noise explains."""


class Truth:
    """Says which pixel of one frame shows what a pixel of another does."""

    def __init__(self, recording: SyntheticRecording) -> None:
        """Of a recording."""
        self.recording = recording
        self.ideal = replace(recording, noise=False, faults=None)
        self.readout = recording.faults.colour_readout if recording.faults else 0.0

    def poses(self, number: int, rows: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 4 4"]:
        """`T_world_cam` at the times of a frame's rows."""
        delays = self.readout * (rows / (self.recording.camera.height - 1) - 0.5)
        return self.recording.poses_at(self.recording.timestamps[number] + delays)

    def projected(
        self, poses: Float[np.ndarray, "n 4 4"], points: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, "n 2"]:
        """Pixels of world points, each seen from a pose of its own."""
        seen = np.einsum(
            "nij,nj->ni", np.linalg.inv(poses)[:, :3], np.pad(points, ((0, 0), (0, 1)), constant_values=1)
        )
        return np.asarray(self.recording.camera.project(jnp.asarray(seen, jnp.float32)), float)

    def moved(self, pixels: Float[np.ndarray, "n 2"], source: int, target: int) -> Float[np.ndarray, "n 2"]:
        """Pixels of the target's surface in the source."""
        camera, depth = self.recording.camera, np.asarray(self.ideal[target].depth, float)
        pose = self.recording.ground_truth.poses[target]
        poses, at = self.poses(target, pixels[:, 1]), pixels.copy()
        points = np.zeros((len(pixels), 3))
        for _ in range(6):  # where the frame's depth shows what the row saw
            inside = np.clip(at, 0, [camera.width - 1.001, camera.height - 1.001])
            z = interpolated(depth, inside)
            rays = np.asarray(camera.unproject(jnp.asarray(inside, jnp.float32), jnp.ones(len(z))), float)
            points = (rays * z[:, None]) @ pose[:3, :3].T + pose[:3, 3]
            at = at + pixels - self.projected(poses, points)
        found = pixels
        for _ in range(4):  # the row that sees it
            found = self.projected(self.poses(source, found[:, 1]), points)
        return found


def interpolated(
    image: Float[np.ndarray, "h w"], pixels: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, " n"]:
    """Bilinear interpolation."""
    (u, v), (right, down) = pixels.astype(int).T, (pixels % 1).T
    upper, lower = (image[row, u] * (1 - right) + image[row, u + 1] * right for row in (v, v + 1))
    return upper * (1 - down) + lower * down


def errors(
    recording: SyntheticRecording, gaps: list[int], *, align: bool
) -> Iterator[Float[np.ndarray, "n 2"]]:
    """Errors of the explained matches of each pair of frames, pixels."""
    tracking = SlamConfig().tracking
    params = tracker_params(
        recording.camera, replace(tracking, features=replace(tracking.features, align_patches=align))
    )
    truth, poses = Truth(recording), recording.ground_truth.poses
    seen = cache(lambda number: observe(params, recording[number]))
    for target in range(60, 280, 20):
        for source in (target + gap for gap in gaps):
            motion = np.linalg.inv(poses[target]) @ poses[source]
            guess = jaxlie.SE3(jnp.asarray(se3.parameters_of(motion[None])[0], jnp.float32))
            matched = register(params, seen(source), seen(target), guess).matched
            inliers = np.asarray(matched.inliers)
            places = np.asarray(seen(target).keypoints.places, float)[np.asarray(matched.index)[inliers]]
            found = np.asarray(matched.pixels, float)[inliers]
            yield found - truth.moved(places, source, target)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--gaps", nargs="+", type=int, default=[2, 5], help="frames between the two")
    options = parser.parse_args()

    def rows() -> Iterator[tuple[str, ...]]:
        for name, recording in SOURCES.items():
            for align in (False, True):
                off = np.concatenate(list(errors(recording, options.gaps, align=align)))
                middle = np.median(off, axis=0)
                deviation = 1.4826 * np.median(np.abs(off - middle), axis=0)
                near = np.all(np.abs(off) < FAR, axis=1)
                yield (
                    name,
                    "by patches" if align else "as detected",
                    str(len(off)),
                    "{:.2f}, {:.2f}".format(*deviation),
                    "{:.2f}, {:.2f}".format(*off[near].mean(axis=0)),
                    f"{100 * (1 - near.mean()):.1f}",
                )

    print_table("where matched keypoints lie", COLUMNS, rows())


if __name__ == "__main__":
    main()
