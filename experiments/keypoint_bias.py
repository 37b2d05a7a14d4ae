"""Do keypoints lie where the scene is? Changed images tell their bias, and a shift removes it.

    python -m experiments.keypoint_bias [--photos 60] [--recordings redkitchen fr1_rpy room]
                                        [--weights FILE] [--write FILE]

An error that all keypoints of an image have in common shows in no pair of like images: it is in both. In an
image that is turned it points another way, and in one that is larger it is a smaller part of the scene. So
keypoints of an image and of changed copies are matched. The error is what explains how they miss each other:
they do by (I - A) error, with A the turn or the factor.

To tracking such an error is a depth camera that is turned against the colour camera. With `--write` the
photographs, turned and zoomed, tell the shift that removes it, and SuperFeats' weights are stored with that.
"""

import argparse
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

import cv2
import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from experiments.extractors import NAMES, make_extractor
from experiments.matching_tables import print_table
from experiments.recordings import DATA, SOURCES
from sfgs_jax.datasets import open_recording, read_photos
from sfgs_jax.superfeats import Features, load_weights, match, save_weights

TURNS = ((-15.0, 1.0), (-8.0, 1.0), (8.0, 1.0), (15.0, 1.0))
ZOOMS = ((0.0, 0.75), (0.0, 0.87), (0.0, 1.15), (0.0, 1.33))
"""Degrees and factors; far enough for the error to show, and near enough for keypoints to be matched."""
Changes = tuple[tuple[float, float], ...]
REACH = 2.5
"""Pixels beyond which a match is taken to be a wrong one."""
ROUNDS = 10
"""Estimates of the error of an image, each with the matches that are right by the one before."""
PER_RECORDING = 12
KEYPOINTS = 512
PLACES = {"room": "synthetic:place=room,frames=80,width=320,height=240"}


class Bias(NamedTuple):
    """Error that all keypoints have in common.

    Attributes:
        pixels: (2,) mean over the images, along u and v.
        sigma: (2,) its standard error over the images.
        matches: number of matches that it was found from.
    """

    pixels: Float[np.ndarray, "2"]
    sigma: Float[np.ndarray, "2"]
    matches: int


def keypoint_bias(
    extract: Callable[[np.ndarray], Features], images: Iterable[np.ndarray], changes: Changes = TURNS + ZOOMS
) -> Bias:
    """Bias of keypoints, by images and changed copies of them.

    Args:
        extract: features of an image (H, W, 3) in [0, 1].
        images: with something to see in them.
        changes: turns in degrees and factors of the copies.
    """
    found = [_of_image(extract, np.asarray(image, np.float32), changes) for image in images]
    errors = np.stack([error for error, count in found if count])
    spread = errors.std(axis=0, ddof=1) / np.sqrt(len(errors))
    return Bias(errors.mean(axis=0), spread, sum(count for _, count in found))


def _of_image(
    extract: Callable[[np.ndarray], Features], image: Float[np.ndarray, "h w 3"], changes: Changes
) -> tuple[Float[np.ndarray, "2"], int]:
    """The error by least squares over all changes, and the number of matches."""
    height, width = image.shape[:2]
    straight, slopes, misses = extract(image), [], []
    for angle, factor in changes:
        change = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), angle, factor)
        # Smaller images get no finer detail than their pixels can hold.
        source = cv2.GaussianBlur(image, (0, 0), 0.5 / factor) if factor < 1 else image
        changed = cv2.warpAffine(
            source, change, (width, height), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101
        )
        other = extract(np.clip(changed, 0, 1))
        matches = match(straight, other)
        valid = np.asarray(matches.valid)
        here = np.asarray(straight.keypoints, np.float64)[valid]
        there = np.asarray(other.keypoints, np.float64)[np.asarray(matches.index_b)[valid]]
        misses.append(there - (here @ change[:, :2].T + change[:, 2]))
        slopes.append(np.broadcast_to(np.eye(2) - change[:, :2], (len(here), 2, 2)))
    return _explanation(np.concatenate(slopes), np.concatenate(misses))


def _explanation(
    slopes: Float[np.ndarray, "n 2 2"], misses: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, "2"], int]:
    """The error that explains the misses of right matches, and their number."""
    error, right = np.zeros(2), np.zeros(len(misses), bool)
    for _ in range(ROUNDS):
        # Around what is explained so far: a gate around none would cut the error short.
        right = np.linalg.norm(misses - slopes @ error, axis=1) < REACH
        if not right.any():
            break
        slope = slopes[right].reshape(-1, 2)
        error = np.linalg.lstsq(slope, misses[right].reshape(-1), rcond=None)[0]
    return error, int(right.sum())


def photographs(folder: Path, count: int) -> list[np.ndarray]:
    """Photographs spread evenly over a set, as wide as most of them, so that few sizes are compiled.

    Args:
        folder: with photographs.
        count: of them.
    """
    photos = read_photos(folder)
    chosen = np.linspace(0, len(photos) - 1, min(count, len(photos))).astype(int).tolist()
    return [cv2.resize(photos[i], (480, 320), interpolation=cv2.INTER_AREA) for i in chosen]


def _frames(name: str) -> list[np.ndarray]:
    recording = open_recording(PLACES.get(name) or SOURCES[name])
    chosen = np.linspace(0, len(recording) - 1, PER_RECORDING).astype(int).tolist()
    return [np.asarray(recording[i].rgb, np.float32) for i in chosen]


def main() -> None:
    """Print the table, and write weights."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=DATA / "photos", help="folder of photographs")
    parser.add_argument("--photos", type=int, default=60)
    parser.add_argument("--recordings", nargs="*", default=["redkitchen", "fr1_rpy", "room"])
    parser.add_argument("--extractors", nargs="*", default=list(NAMES), choices=NAMES)
    parser.add_argument("--weights", type=Path, help="of SuperFeats; by default those of the package")
    parser.add_argument("--write", type=Path, help="SuperFeats' weights without the photographs' error")
    options = parser.parse_args()
    images = {"photographs": photographs(options.data, options.photos)} if options.photos else {}
    images |= {name: _frames(name) for name in options.recordings}
    rows = []
    for name in options.extractors:
        extractor = make_extractor(name, max_keypoints=KEYPOINTS, weights=options.weights)
        for label, shown in images.items():
            found = [keypoint_bias(extractor.extract, shown, by) for by in (TURNS, ZOOMS, TURNS + ZOOMS)]
            cells = (f"{p:+.2f} ± {s:.2f}" for b in found for p, s in zip(b.pixels, b.sigma, strict=True))
            rows.append((name, label, *cells, str(found[-1].matches)))
            if name == "superfeats" and label == "photographs" and options.write:
                network = load_weights(options.weights)
                shift = network.shift - jnp.asarray(found[-1].pixels, jnp.float32)
                save_weights(options.write, eqx.tree_at(lambda n: n.shift, network, shift))
    ways = ("turned: right", "down", "zoomed: right", "down", "both: right", "down")
    print_table("Bias of keypoints, pixels", ("keypoints", "images", *ways, "matches"), rows)


if __name__ == "__main__":
    main()
