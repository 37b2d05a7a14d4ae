"""What the depth images say of poses: how far apart the surfaces of distant frames lie by them.

    python -m experiments.surface_agreement [--recordings redkitchen fr1_rpy]

Pairs of frames far apart in time that see the same place are laid over each other, by the poses that the
system finds and by those that come with the recording. Points of one frame are carried to the other, and
their distances from its surface, along the normals, are taken. No registration is involved, and no frame of
a pair has to be a keyframe. Where the recording's own poses lay surfaces farther apart than the system's, an
ATE measures the recording's poses as much as the system's. Everything is tracked without a map.
"""

from itertools import product
from typing import Literal

import jax.numpy as jnp
import numpy as np
import tyro
from jaxtyping import Float

from experiments.matching_tables import print_table
from experiments.recordings import SOURCES
from sfgs_jax.datasets import Recording, open_recording, prefetch
from sfgs_jax.geometry import Camera, FrameError, clean_depth
from sfgs_jax.geometry.surface import surface
from sfgs_jax.slam import SlamConfig, init
from sfgs_jax.slam.step import follow

EVERY = 10
"""Frames from one that is looked at to the next."""
MIN_FRAMES = 60
"""Between the frames of a pair."""
MAX_METRES, MAX_DEGREES = 0.5, 20.0
"""Between their cameras."""
STRIDE = 4
GATE = 0.1
"""Points farther from the other surface than this are of something else, metres."""
MIN_POINTS = 2000
COLUMNS = ("recording", "pairs", "poses", "median cm", "90th percentile cm", "within 1 cm %")


class Surfaces:
    """Points and normals of frames, made when asked for."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._made: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def __getitem__(self, index: int) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h w 3"]]:
        """(H, W, 3) points and normals, zero where there are none."""
        if index not in self._made:
            depth, _ = clean_depth(jnp.asarray(self._recording[index].depth))
            found = surface(depth, self._recording.camera)
            valid = np.asarray(found.valid)[..., None]
            self._made[index] = np.where(valid, found.points, 0), np.where(valid, found.normals, 0)
        return self._made[index]


def distances(
    a: tuple[np.ndarray, np.ndarray], b: tuple[np.ndarray, np.ndarray], T_b_a: np.ndarray, camera: Camera
) -> Float[np.ndarray, " n"]:
    """Distances of a's points from b's surface along its normals, metres, of those that have it near."""
    points = a[0][::STRIDE, ::STRIDE].reshape(-1, 3).astype(np.float64)
    points = points[points[:, 2] > 0] @ T_b_a[:3, :3].T + T_b_a[:3, 3]
    points = points[points[:, 2] > 0]
    K = np.asarray(camera.matrix(), np.float64)
    u, v = np.rint((points @ K.T)[:, :2] / points[:, 2:]).astype(int).T
    height, width = camera.shape
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    points, u, v = points[inside], u[inside], v[inside]
    across = ((points - b[0][v, u]) * b[1][v, u]).sum(1)
    near = (b[0][v, u, 2] > 0) & (np.linalg.norm(points - b[0][v, u], axis=1) < GATE)
    return np.abs(across[near])


def pairs(poses: Float[np.ndarray, "n 4 4"]) -> list[tuple[int, int]]:
    """Frames far apart whose cameras are close together and look the same way."""
    numbers = range(0, len(poses), EVERY)
    found = []
    for i, j in product(numbers, numbers):
        apart = np.linalg.norm(poses[i, :3, 3] - poses[j, :3, 3])
        turned = np.degrees(np.arccos(np.clip(poses[i, :3, 2] @ poses[j, :3, 2], -1, 1)))
        if j - i >= MIN_FRAMES and apart < MAX_METRES and turned < MAX_DEGREES:
            found.append((i, j))
    return found


def measure(name: str) -> list[tuple[str, ...]]:
    """Track a recording and give its two rows of the table."""
    recording = open_recording(SOURCES[name])
    truth = recording.ground_truth
    state = init(recording.camera, SlamConfig())
    for _, frame in prefetch(recording):
        if not isinstance(frame, FrameError):
            state, _, _ = follow(state, frame)
    found = state.trajectory
    if truth is None or not len(found) == len(truth.poses) == len(recording):
        raise SystemExit(f"{name}: every frame needs a pose, found and given, to be compared.")
    surfaces = Surfaces(recording)
    used, by_poses = 0, ([], [])
    for i, j in pairs(found.poses):
        both = [
            distances(surfaces[i], surfaces[j], np.linalg.inv(poses[j]) @ poses[i], recording.camera)
            for poses in (found.poses, truth.poses)
        ]
        if min(map(len, both)) >= MIN_POINTS:
            used += 1
            for values, new in zip(by_poses, both, strict=True):
                values.append(new)
    rows = []
    for source, values in zip(("found", "the recording's"), by_poses, strict=True):
        cm = 100 * np.concatenate(values)
        shown = np.median(cm), np.percentile(cm, 90), 100 * np.mean(cm < 1)
        rows.append((name, str(used), source, *(f"{x:.2f}" for x in shown[:2]), f"{shown[2]:.0f}"))
    return rows


def main(
    recordings: tuple[Literal["redkitchen", "fr1_rpy"], ...] = ("redkitchen",),
) -> None:
    """Print the table."""
    rows = [row for name in recordings for row in measure(name)]
    print_table("Surfaces of frames far apart in time", COLUMNS, rows)


if __name__ == "__main__":
    tyro.cli(main)
