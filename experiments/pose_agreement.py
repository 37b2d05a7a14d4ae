"""Agreement of poses with a recording's images: of those that the system finds, and those that come with it.

    python -m experiments.pose_agreement [--recordings redkitchen fr1_rpy]

By depth: pairs of frames far apart in time that see the same place are laid over each other by either poses.
Points of one frame are carried to the other, and their distances from its surface, along the normals, are
taken. No registration is involved, and no frame of a pair has to be a keyframe.

By colour: ORB's keypoints, which the system does not use, of frames fifty apart are matched. PnP
and RANSAC find a camera that sees a share of the matches where they are, without any of the poses. Those
matches are carried from frame to frame by either poses, and how far they miss is taken, in pixels.

If the recording's own poses miss by more than the system's, an ATE measures them as much as the system's.
*Sensors modelled* poses are judged by depth as the run has corrected it, the others by depth as it was
recorded. Everything is tracked without a map.
"""

from dataclasses import replace
from itertools import product
from typing import Literal, NamedTuple, Protocol

import cv2
import jax.numpy as jnp
import numpy as np
import tyro
from jaxtyping import Float

from experiments.matching_tables import print_table
from experiments.recordings import SOURCES
from sfgs_jax.arrays import FrameError
from sfgs_jax.datasets import Recording, open_recording, prefetch
from sfgs_jax.geometry import Camera, Frame, clean_depth, surface
from sfgs_jax.slam import SlamConfig, TrackerParams, finish, follow, init
from sfgs_jax.slam.frontend import with_corrected_depth
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


class Images(Protocol):
    """Frames of a camera by number, as a `Recording` gives them."""

    @property
    def camera(self) -> Camera:
        """Intrinsics of the frames."""
        ...

    def __getitem__(self, index: int) -> Frame:
        """A frame."""
        ...


class Surfaces:
    """Points and normals of frames, made when asked for."""

    def __init__(self, recording: Images) -> None:
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
    recording: Images, i: int, j: int
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


class Corrected:
    """A recording with its depth corrected as a run has found it."""

    def __init__(self, recording: Recording, params: TrackerParams) -> None:
        self._recording, self._params = recording, params
        self.camera = recording.camera

    def __getitem__(self, index: int) -> Frame:
        return with_corrected_depth(self._params, self._recording[index])


class Poses(NamedTuple):
    """Poses, and the images that they are judged by.

    Attributes:
        name: where they are from.
        poses: (N, 4, 4) `T_world_cam`.
        images: of the recording, with the depth that the poses were found by.
    """

    name: str
    poses: Float[np.ndarray, "n 4 4"]
    images: Images


def tracked(name: str) -> list[Poses]:
    """Poses found for a recording, without and with the sensors modelled, and those that come with it."""
    recording = open_recording(SOURCES[name])
    truth, found = recording.ground_truth, []
    for title, on in (("found", False), ("found, sensors modelled", True)):
        tracking = replace(SlamConfig().tracking, estimate_timing=on, estimate_depth=on)
        state = init(recording.camera, replace(SlamConfig(), tracking=tracking))
        for _, frame in prefetch(recording):
            if not isinstance(frame, FrameError):
                state, _, _ = follow(state, frame)
        state = finish(state)
        if truth is None or not len(state.trajectory) == len(truth.poses) == len(recording):
            raise SystemExit(f"{name}: every frame needs a pose, found and given, to be compared.")
        found.append(Poses(title, state.trajectory.poses, Corrected(recording, state.params)))
    assert truth is not None
    return [*found, Poses("the recording's", truth.poses, recording)]


def by_depth(kinds: list[Poses]) -> list[list[np.ndarray]]:
    """Of every pair of frames, centimetres between the surfaces by each kind of poses."""
    measured = []
    for _, poses, images in kinds:
        surfaces = Surfaces(images)
        measured.append(
            [
                100 * distances(surfaces[i], surfaces[j], np.linalg.inv(poses[j]) @ poses[i], images.camera)
                for i, j in pairs(kinds[0].poses)
            ]
        )
    by_pair = [list(pair) for pair in zip(*measured, strict=True)]
    return [pair for pair in by_pair if min(map(len, pair)) >= MIN_POINTS]


def by_colour(kinds: list[Poses]) -> list[list[np.ndarray]]:
    """Of every pair of frames, pixels by which matches miss by each kind of poses."""
    found = []
    for i in range(0, len(kinds[0].poses) - GAP, EVERY):
        matches = [agreed_matches(images, i, i + GAP) for _, _, images in kinds]
        if all(m is not None for m in matches):
            found.append(
                [
                    misses(*m, np.linalg.inv(poses[i + GAP]) @ poses[i], images.camera)
                    for m, (_, poses, images) in zip(matches, kinds, strict=True)
                    if m is not None
                ]
            )
    return found


def rows(name: str, kinds: list[Poses], measured: list[list[np.ndarray]]) -> list[tuple[str, ...]]:
    """The rows of a recording."""
    return [
        (name, str(len(measured)), kind.name, f"{np.median(values):.2f}", f"{np.percentile(values, 90):.2f}")
        for kind, values in zip(kinds, map(np.concatenate, zip(*measured, strict=True)), strict=True)
    ]


def main(
    recordings: tuple[Literal["redkitchen", "fr1_rpy"], ...] = ("redkitchen",),
) -> None:
    """Print the tables."""
    depth, colour = [], []
    for name in recordings:
        kinds = tracked(name)
        depth += rows(name, kinds, by_depth(kinds))
        colour += rows(name, kinds, by_colour(kinds))
    print_table("Surfaces of frames far apart in time, cm", COLUMNS, depth)
    print_table(f"Matches between frames {GAP} apart, pixels", COLUMNS, colour)


if __name__ == "__main__":
    tyro.cli(main)
