"""Where the depth camera of 7-Scenes sits beside its colour camera, found from the images alone.

    python -m experiments.seven_scenes_calibration [--source DIR] [--start 0] [--end 300] [--every 6]

Outlines of near things in the depth image, carried into the colour image, should lie on its edges. The
rotation and translation are those for which they do: for which the colour image's gradient across the
outlines is largest. No poses are used. The other frames tell whether the result holds for more than those it
was found on. The reader of 7-Scenes has what this prints for RedKitchen's frames 0 to 299.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import tyro
from scipy.optimize import minimize

from experiments.feature_matching import REDKITCHEN

COLOUR_FOCAL, DEPTH_FOCAL = 525.0, 585.0
GENERIC_R = np.array(
    [
        [0.99996518, 0.00267651, -0.00790410],
        [-0.00274093, 0.99996303, -0.00815045],
        [0.00788199, 0.00817183, 0.99993555],
    ]
)
GENERIC_T = np.array([-0.025559, 0.000101, 0.002032])
"""The Kinect that later work on this set takes for its own; the search begins there."""

_STEPS = np.array([5e-3, 5e-3, 1e-2, 3e-3, 3e-3, 3e-3])
"""Of the search: metres, then radians."""
_MARGIN = 20
_STRONGEST = 4.0
"""A gradient counts at most this many times the image's mean."""


@dataclass(frozen=True)
class Outlines:
    """Pixels of one depth image next to something farther away.

    Attributes:
        points: (N, 3) where they are, depth camera.
        across: (N,) whether what is farther is beside the pixel (1) or above or below it (0).
        gradients: (2, H, W) of the colour image down and across, absolute, over its mean.
    """

    points: np.ndarray
    across: np.ndarray
    gradients: np.ndarray


def outlines(colour: Path) -> Outlines:
    """Of the frame with this colour image."""
    grey = cv2.imread(str(colour), cv2.IMREAD_GRAYSCALE)
    raw = cv2.imread(str(colour.parent / f"{colour.name.split('.')[0]}.depth.png"), cv2.IMREAD_UNCHANGED)
    if grey is None or raw is None:
        raise SystemExit(f"{colour} or its depth image can't be read.")
    soft = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), 1.5)
    slopes = np.abs([cv2.Sobel(soft, cv2.CV_32F, 0, 1), cv2.Sobel(soft, cv2.CV_32F, 1, 0)])
    gradients = np.minimum(slopes / slopes.mean((1, 2), keepdims=True), _STRONGEST)

    depth = np.where(raw == np.iinfo(np.uint16).max, 0, raw) / 1000.0
    height, width = depth.shape
    inner = np.zeros(depth.shape, bool)
    inner[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN] = True
    points, across = [], []
    for axis in (0, 1):
        for side in (1, -1):
            next_, beyond = (np.roll(depth, n * side, axis) for n in (1, 3))
            steps = (depth > 0) & (next_ > 0) & (next_ > 1.08 * depth) & (beyond > 1.12 * depth) & inner
            v, u = np.nonzero(steps)
            # The outline lies between the two pixels.
            pixels = np.column_stack([u, v]) - 0.5 * side * np.array([axis, 1 - axis])
            z = depth[v, u, None]
            points.append(np.hstack([(pixels - [width / 2, height / 2]) / DEPTH_FOCAL * z, z]))
            across.append(np.full(len(u), axis))
    return Outlines(np.concatenate(points), np.concatenate(across), gradients)


def transform(change: np.ndarray) -> np.ndarray:
    """(4, 4) T_colour_depth of a change (translation, rotation vector) to the generic one, in steps."""
    moved = change * _STEPS
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(moved[3:])[0] @ GENERIC_R
    T[:3, 3] = GENERIC_T + moved[:3]
    return T


def alignment(frames: Iterable[Outlines], T_colour_depth: np.ndarray) -> float:
    """Mean gradient of the colour images across the outlines, over the images' means."""
    total, count = 0.0, 0
    for frame in frames:
        height, width = frame.gradients.shape[1:]
        points = frame.points @ T_colour_depth[:3, :3].T + T_colour_depth[:3, 3]
        pixels = COLOUR_FOCAL * points[:, :2] / points[:, 2:] + [width / 2, height / 2]
        for axis, gradient in enumerate(frame.gradients):
            u, v = pixels[frame.across == axis].astype(np.float32).T
            total += cv2.remap(gradient, u[None], v[None], cv2.INTER_LINEAR).sum()
            count += len(u)
    return total / count


def main(source: Path = Path(REDKITCHEN), start: int = 0, end: int = 300, every: int = 6) -> None:
    """Find the calibration on frames start to end, and print it and how well it fits there and elsewhere.

    Args:
        source: folder of a 7-Scenes sequence.
        start: first frame.
        end: one after the last.
        every: take every n-th frame.
    """
    colour = sorted(source.glob("frame-*.color.*"))
    used = [outlines(path) for path in colour[start:end:every]]
    others = [outlines(path) for path in (colour[:start] + colour[end:])[::every]]
    change = np.zeros(len(_STEPS))
    for _ in range(2):  # the second search starts with a fresh simplex
        simplex = change + np.vstack([np.zeros(len(change)), np.eye(len(change))])
        change = minimize(
            lambda x: -alignment(used, transform(x)),
            change,
            method="Nelder-Mead",
            options={"initial_simplex": simplex, "xatol": 0.01, "fatol": 1e-4},
        ).x
    for name, T in (("generic", transform(0 * change)), ("found", transform(change))):
        print(
            f"{name}: gradient across outlines {alignment(used, T):.3f}, on others {alignment(others, T):.3f}"
        )
    print(np.array2string(transform(change), precision=8, suppress_small=True, separator=", "))


if __name__ == "__main__":
    tyro.cli(main)
