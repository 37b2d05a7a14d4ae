"""Training pairs for SuperFeats: two views of a photograph or of a recording, labelled by XFeat."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Protocol

import cv2
import jax.numpy as jnp
import numpy as np

from experiments.xfeat import XFeat, normalised
from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import ReaderOptions, open_recording
from sfgs_jax.superfeats.network import CELL
from sfgs_jax.superfeats.training import Batch, ViewConfig, occlude, random_homography, relight, warp

SIZE = 320
"""Side of a view, pixels: four views fill the teacher's input of 640 x 640."""

POINTS = 512
"""Correspondences a pair, at most one in a cell."""

_CELLS = SIZE // CELL
_MIN_HEAT = 0.03
"""Least probability of a keypoint by the teacher; a cell with less gives a random point."""

_BORDER = 4.0
"""Distance from the border of a view below which a point does not count as seen, pixels."""

_DEPTH_TOLERANCE = 0.03
"""Largest relative difference between a carried point's depth and the measured one."""

_RGBD_VIEW = ViewConfig(max_rotation_deg=15.0, scale=(0.8, 1.25), perspective=0.04, translation=0.05)

Carry = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Takes pixels (N, 2) of the first image to the second, and returns a mask (N,) of those seen there."""


@dataclass(frozen=True)
class Drawn:
    """Two grey images of the same place.

    Attributes:
        first: (H, W) grey, in [0, 1].
        second: (H, W) grey, in [0, 1].
        carry: from the first image's pixels to the second's.
        change: largest differences of the views made of them.
        planar: whether both are one image.
    """

    first: np.ndarray
    second: np.ndarray
    carry: Carry
    change: ViewConfig
    planar: bool


@dataclass(frozen=True)
class Views:
    """A pair of views: both images warped, relit and partly covered.

    Attributes:
        images: (2, S, S) normalised.
        covered: (2, S, S) mask of the pixels that something covers.
        carry: from the first view's pixels to the second's.
        H_b_a: (3, 3) the same as a homography, if the pair is planar.
        planar: whether both are views of one image.
    """

    images: np.ndarray
    covered: np.ndarray
    carry: Carry
    H_b_a: np.ndarray
    planar: bool


class Scenes(Protocol):
    """A source of pairs."""

    def draw(self, rng: np.random.Generator) -> Drawn:
        """Draw a random pair of images."""
        ...


class Photos:
    """Photographs: both images of a pair are the same one, and only the views differ."""

    def __init__(self, paths: Sequence[Path]) -> None:
        if not paths:
            raise InputError("There are no photographs to train on.")
        self._paths = list(paths)

    def draw(self, rng: np.random.Generator) -> Drawn:
        path = self._paths[rng.integers(len(self._paths))]
        image = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if image is None:
            raise InputError(f"{path} can't be read as an image.")
        grey = image.mean(2, dtype=np.float32) / 255
        return Drawn(grey, grey, lambda pixels: (pixels, np.ones(len(pixels), bool)), ViewConfig(), True)


def held_out(photos: Sequence[Path]) -> Sequence[Path]:
    """Photographs for judging, not for training: every twentieth of a sorted set."""
    return photos[::20]


class RecordingPairs:
    """Frames of an RGB-D recording with known poses, a few to many frames apart."""

    def __init__(self, source: Path, *, start: int, end: int, gaps: tuple[int, int] = (3, 45)) -> None:
        recording = open_recording(source, options=ReaderOptions(start=start, end=end))
        truth = recording.ground_truth
        if truth is None:
            raise InputError(f"{source} has no poses; pairs need them.")
        self._camera = recording.camera
        poses = dict(zip(truth.timestamps.tolist(), truth.poses, strict=True))
        self._gaps = gaps
        self._greys: list[np.ndarray] = []
        self._depths: list[np.ndarray] = []
        self._T_world_cam: list[np.ndarray] = []
        for index, timestamp in enumerate(recording.timestamps.tolist()):
            if timestamp in poses:
                frame = recording[index]
                self._greys.append(np.rint(np.asarray(frame.rgb).mean(2) * 255).astype(np.uint8))
                self._depths.append(np.rint(np.asarray(frame.depth) * 1000).astype(np.uint16))
                self._T_world_cam.append(poses[timestamp])

    def draw(self, rng: np.random.Generator) -> Drawn:
        first = int(rng.integers(len(self._greys) - self._gaps[0]))
        gap = int(rng.integers(self._gaps[0], self._gaps[1] + 1))
        second = min(first + gap, len(self._greys) - 1)
        if rng.random() < 0.5:
            first, second = second, first
        a, b = (self._greys[index].astype(np.float32) / 255 for index in (first, second))
        return Drawn(a, b, lambda pixels: self._carry(first, second, pixels), _RGBD_VIEW, False)

    def _carry(self, first: int, second: int, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        camera = self._camera
        focal = np.array([float(camera.fx), float(camera.fy)])
        centre = np.array([float(camera.cx), float(camera.cy)])
        depth = _look_up(self._depths[first], pixels)
        points = np.column_stack([(pixels - centre) / focal * depth[:, None], depth])
        T = np.linalg.inv(self._T_world_cam[second]) @ self._T_world_cam[first]
        points = points @ T[:3, :3].T + T[:3, 3]
        z = np.maximum(points[:, 2], 1e-3)
        carried = points[:, :2] / z[:, None] * focal + centre
        there = _look_up(self._depths[second], carried)
        seen = (depth > 0) & (there > 0) & (np.abs(there - z) < _DEPTH_TOLERANCE * z)
        return carried, seen


def batches(
    scenes: Sequence[tuple[float, Scenes]], teacher: XFeat, *, pairs: int, seed: int, first: int = 0
) -> Iterator[Batch]:
    """Endless stream of batches, made beside the training; batch i is the same in every run.

    Args:
        scenes: sources of pairs, each with its share.
        teacher: labels the views.
        pairs: pairs in a batch, even.
        seed: of the whole stream.
        first: number of the first batch, to continue after a stop.
    """
    numbers = count(first)
    with ThreadPoolExecutor(2) as pool:
        waiting: deque[Future[Batch]] = deque(
            pool.submit(_batch, scenes, teacher, pairs, seed, next(numbers)) for _ in range(4)
        )
        while True:
            batch = waiting.popleft().result()
            waiting.append(pool.submit(_batch, scenes, teacher, pairs, seed, next(numbers)))
            yield batch


def _batch(
    scenes: Sequence[tuple[float, Scenes]], teacher: XFeat, pairs: int, seed: int, number: int
) -> Batch:
    rng = np.random.default_rng([seed, number])
    shares = np.array([share for share, _ in scenes])
    made = []
    while len(made) < pairs:
        scene = scenes[rng.choice(len(scenes), p=shares / shares.sum())][1]
        pair = _views(rng, scene.draw(rng))
        if pair is not None:
            made.append(pair)
    images = np.stack([views.images for views in made])
    heat, descriptors, reliability = _labels(teacher, images)
    points, seen = zip(
        *(_points(rng, heat[index, 0], views) for index, views in enumerate(made)),
        strict=True,
    )
    labelled = np.zeros(reliability.shape, np.float32)
    labelled[:, :, 1:-1, 1:-1] = 1
    return Batch(
        images=jnp.asarray(images),
        heat=jnp.asarray(heat),
        descriptors=jnp.asarray(descriptors),
        reliability=jnp.asarray(reliability),
        labelled=jnp.asarray(labelled),
        points=jnp.asarray(np.stack(points)),
        seen=jnp.asarray(np.stack(seen)),
        H_b_a=jnp.asarray(np.stack([views.H_b_a for views in made]), jnp.float32),
        planar=jnp.asarray([views.planar for views in made], jnp.float32),
        hidden=jnp.asarray(np.stack([views.covered for views in made])),
    )


def _views(rng: np.random.Generator, drawn: Drawn) -> Views | None:
    """Two views of a pair; None if they hardly overlap."""
    first = _crop(rng, drawn.first.shape)
    middle = np.array([[(SIZE - 1) / 2, (SIZE - 1) / 2]])
    carried, seen = drawn.carry(_apply(np.linalg.inv(first), middle))
    if not seen[0]:
        return None
    shift = np.eye(3)
    shift[:2, 2] = _apply(np.linalg.inv(first), middle)[0] - carried[0]
    second = random_homography(rng, SIZE, drawn.change) @ first @ shift

    def carry(pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        there, seen = drawn.carry(_apply(np.linalg.inv(first), pixels))
        there = _apply(second, there)
        inside = (there > _BORDER).all(1) & (there < SIZE - 1 - _BORDER).all(1)
        return there, seen & inside

    views = [warp(drawn.first, first, SIZE), warp(drawn.second, second, SIZE)]
    covered = []
    for index, image in enumerate(views):
        image, mask = occlude(rng, relight(rng, image))
        views[index] = normalised(image)
        covered.append(mask)
    H_b_a = second @ np.linalg.inv(first)
    return Views(np.stack(views), np.stack(covered), carry, H_b_a, drawn.planar)


def _crop(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Similarity that takes a random part of an image to a view."""
    height, width = shape
    scale = SIZE / min(height, width) * np.exp(rng.uniform(-0.05, np.log(2.0)))
    extent = SIZE / scale
    corner = [rng.uniform(min(0, side - extent), max(0, side - extent)) for side in (width, height)]
    return np.array([[scale, 0, -scale * corner[0]], [0, scale, -scale * corner[1]], [0, 0, 1]])


def _labels(teacher: XFeat, images: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Heat, descriptors and reliability by the teacher for (B, 2, S, S) images, four views at a time."""
    views = images.reshape(-1, 2, 2, SIZE, SIZE)
    parts: list[list[np.ndarray]] = [[], [], []]
    for mosaic in views:
        for part, dense in zip(
            parts, teacher.dense(mosaic.swapaxes(1, 2).reshape(2 * SIZE, -1)), strict=True
        ):
            cells = dense.reshape(2, _CELLS, 2, _CELLS, -1).swapaxes(1, 2)
            part.append(cells.reshape(4, _CELLS, _CELLS, -1))
    logits, descriptors, reliability = (
        np.concatenate(part).reshape(*images.shape[:2], _CELLS, _CELLS, -1) for part in parts
    )
    weights = np.exp(logits - logits.max(-1, keepdims=True))
    heat = weights / weights.sum(-1, keepdims=True)
    descriptors = descriptors / np.maximum(np.linalg.norm(descriptors, axis=-1, keepdims=True), 1e-6)
    return heat, descriptors, reliability[..., 0]


def _points(rng: np.random.Generator, heat: np.ndarray, views: Views) -> tuple[np.ndarray, np.ndarray]:
    """Points (2, N, 2) of a pair and a mask (N,) of the seen: each cell's keypoint, or a random place."""
    best = heat[..., :-1].argmax(-1).reshape(-1)
    strength = heat[..., :-1].max(-1).reshape(-1)
    place = np.where(strength > _MIN_HEAT, best, rng.integers(0, CELL * CELL, best.size))
    rows, columns = np.divmod(np.arange(best.size), _CELLS)
    pixels = np.column_stack([columns * CELL + place % CELL, rows * CELL + place // CELL]).astype(np.float64)
    there, seen = views.carry(pixels)
    for covered, places in zip(views.covered, (pixels, there), strict=True):
        seen &= ~_look_up(covered, places, 1.0).astype(bool)
    # Seen ones first, keypoints twice as likely as other places.
    order = np.argsort(-(seen * (1.0 + (strength > _MIN_HEAT)) * rng.random(best.size)), kind="stable")[
        :POINTS
    ]
    points = np.stack([pixels[order], np.where(seen[order, None], there[order], 0)]).astype(np.float32)
    return points, seen[order]


def _apply(H: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Pixels (N, 2) through a homography."""
    mapped = np.column_stack([pixels, np.ones(len(pixels))]) @ H.T
    return mapped[:, :2] / mapped[:, 2:]


def _look_up(image: np.ndarray, pixels: np.ndarray, unit: float = 1e-3) -> np.ndarray:
    """Values at the nearest pixels, times `unit`; 0 outside."""
    height, width = image.shape
    u, v = np.rint(np.nan_to_num(np.clip(pixels, -1e6, 1e6))).astype(int).T
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    return np.where(inside, image[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)], 0) * unit
