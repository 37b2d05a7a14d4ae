"""What a recording's images say of poses, those that the system finds and those that come with it.

    python -m experiments.pose_agreement [--recordings redkitchen fr1_rpy]

By depth: pairs of frames far apart in time that see the same place are laid over each other by either poses.
Points of one frame are carried to the other, and their distances from its surface, along the normals, are
taken. No registration is involved, and no frame of a pair has to be a keyframe.

By colour: ORB's keypoints, which the system does not use, of frames fifty apart are matched. A camera
that sees a share of the matches where they are is found by PnP and RANSAC, without any of the poses;
those matches are carried from frame to frame by either poses, and how far they miss is taken, in pixels.

Where the recording's own poses miss by more than the system's, an ATE measures the recording's poses as much
as the system's. Everything is tracked without a map.
"""

from itertools import product
from typing import Literal

import cv2
import jax.numpy as jnp
import numpy as np
import tyro
from jaxtyping import Float

from experiments.matching_tables import print_table
from experiments.recordings import SOURCES
from sfgs_jax.arrays import FrameError
from sfgs_jax.datasets import Recording, open_recording, prefetch
from sfgs_jax.geometry import Camera, clean_depth, surface
from sfgs_jax.slam import SlamConfig, follow, init
from sfgs_jax.superfeats import extract_orb, match

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
GAP = 50
"""Frames from one image of a pair to the other."""
KEYPOINTS, MATCHED_PIXELS, MIN_MATCHES = 2000, 4.0, 40
COLUMNS = ("recording", "pairs", "poses", "median", "90th percentile")


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


def pairs(poses: Float[np.ndarray, "n 4 4"], stride: int = 1) -> list[tuple[int, int]]:
    """Frames far apart whose cameras are close together and look the same way.

    Args:
        poses: (N, 4, 4) of every `stride`-th frame of a recording; a frame whose pose is NaN is in no pair.
        stride: frames of the recording from one pose to the next.
    """
    numbers = range(0, len(poses), max(1, EVERY // stride))
    found = []
    for i, j in product(numbers, numbers):
        apart = np.linalg.norm(poses[i, :3, 3] - poses[j, :3, 3])
        turned = np.degrees(np.arccos(np.clip(poses[i, :3, 2] @ poses[j, :3, 2], -1, 1)))
        if (j - i) * stride >= MIN_FRAMES and apart < MAX_METRES and turned < MAX_DEGREES:
            found.append((i, j))
    return found


def agreed_matches(
    recording: Recording, i: int, j: int
) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 2"]] | None:
    """Matches of two frames that one camera motion explains, by PnP; None if there are few.

    Returns:
        (M, 3) points in camera coordinates of frame i, metres, and (M, 2) their pixels in frame j.
    """
    K = np.asarray(recording.camera.matrix(), np.float64)
    frames = recording[i], recording[j]
    a, b = (extract_orb(np.asarray(frame.rgb), max_keypoints=KEYPOINTS) for frame in frames)
    matches = match(a, b)
    valid = np.asarray(matches.valid)
    from_ = np.asarray(a.keypoints, np.float64)[valid]
    to = np.asarray(b.keypoints, np.float64)[np.asarray(matches.index_b)[valid]]
    u, v = np.rint(from_).astype(int).T
    z = np.asarray(frames[0].depth, np.float64)[v, u]
    from_, to, z = from_[z > 0], to[z > 0], z[z > 0, None]
    points = np.hstack([(from_ - K[:2, 2]) / np.diag(K)[:2], np.ones_like(z)]) * z
    if len(points) < MIN_MATCHES:
        return None
    _, _, _, agree = cv2.solvePnPRansac(points, to, K, None, reprojectionError=MATCHED_PIXELS)
    if agree is None or len(agree) < MIN_MATCHES:
        return None
    agreed = np.ravel(agree).astype(np.intp)
    return points[agreed], to[agreed]


def misses(
    points: Float[np.ndarray, "m 3"], to: Float[np.ndarray, "m 2"], T_b_a: np.ndarray, camera: Camera
) -> Float[np.ndarray, " m"]:
    """Pixels by which a motion (4, 4) carries points of frame a past their pixels in frame b."""
    seen = (points @ T_b_a[:3, :3].T + T_b_a[:3, 3]) @ np.asarray(camera.matrix(), np.float64).T
    return np.linalg.norm(seen[:, :2] / seen[:, 2:] - to, axis=1)


def tracked(name: str) -> tuple[Recording, tuple[np.ndarray, np.ndarray]]:
    """A recording with the poses (N, 4, 4) found and those that come with it."""
    recording = open_recording(SOURCES[name])
    truth = recording.ground_truth
    state = init(recording.camera, SlamConfig())
    for _, frame in prefetch(recording):
        if not isinstance(frame, FrameError):
            state, _, _ = follow(state, frame)
    found = state.trajectory
    if truth is None or not len(found) == len(truth.poses) == len(recording):
        raise SystemExit(f"{name}: every frame needs a pose, found and given, to be compared.")
    return recording, (found.poses, truth.poses)


def by_depth(recording: Recording, poses: tuple[np.ndarray, np.ndarray]) -> list[list[np.ndarray]]:
    """Of every pair of frames, centimetres between the surfaces by either poses."""
    surfaces = Surfaces(recording)
    both = [
        [
            100 * distances(surfaces[i], surfaces[j], np.linalg.inv(T[j]) @ T[i], recording.camera)
            for T in poses
        ]
        for i, j in pairs(poses[0])
    ]
    return [pair for pair in both if min(map(len, pair)) >= MIN_POINTS]


def by_colour(recording: Recording, poses: tuple[np.ndarray, np.ndarray]) -> list[list[np.ndarray]]:
    """Of every pair of frames, pixels by which matches miss by either poses."""
    found = []
    for i in range(0, len(recording) - GAP, EVERY):
        matches = agreed_matches(recording, i, i + GAP)
        if matches is not None:
            motions = [np.linalg.inv(T[i + GAP]) @ T[i] for T in poses]
            found.append([misses(*matches, motion, recording.camera) for motion in motions])
    return found


def rows(name: str, measured: list[list[np.ndarray]]) -> list[tuple[str, ...]]:
    """The rows of a recording."""
    return [
        (name, str(len(measured)), source, f"{np.median(values):.2f}", f"{np.percentile(values, 90):.2f}")
        for source, values in zip(
            ("found", "the recording's"), map(np.concatenate, zip(*measured, strict=True)), strict=True
        )
    ]


def main(
    recordings: tuple[Literal["redkitchen", "fr1_rpy"], ...] = ("redkitchen",),
) -> None:
    """Print the tables."""
    depth, colour = [], []
    for name in recordings:
        recording, poses = tracked(name)
        depth += rows(name, by_depth(recording, poses))
        colour += rows(name, by_colour(recording, poses))
    print_table("Surfaces of frames far apart in time, cm", COLUMNS, depth)
    print_table(f"Matches between frames {GAP} apart, pixels", COLUMNS, colour)


if __name__ == "__main__":
    tyro.cli(main)
