"""Place recognition by signatures of images: how many components of a descriptor are enough.

    python -m experiments.signatures [--sources building room redkitchen fr1_rpy tartanair] [--orb]

Every so many frames one is taken as a keyframe, and one between two of them is looked for. It is found where
a keyframe within 1 m and 30 degrees of it is the most similar one, or among the four most similar ones, which
a lost frame is registered to. The last column is the time of one search among 100,000 signatures. Real
recordings are found through SFGS_DATA, by default `../shared`.
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from experiments.matching_tables import print_table
from experiments.relocalisation import CASES, Case
from sfgs_jax.datasets import open_recording
from sfgs_jax.slam import PRESETS, observe, tracker_params
from sfgs_jax.slam.frontend import image_signature, most_similar
from sfgs_jax.superfeats import Features

_COMPONENTS = (8, 16, 24, 32, 48, 64)
_METRES, _COSINE = 1.0, np.cos(np.radians(30))
_CANDIDATES = 4
_MANY = 100_000


def frames_of(case: Case, *, orb: bool) -> tuple[Float[np.ndarray, "n 4 4"], list[Features]]:
    """(n, 4, 4) true poses and the keypoints of every second frame of a case, keyframes and others by turns.

    Args:
        case: how its frames are taken.
        orb: whether the keypoints are those of ORB.
    """
    recording = open_recording(case.source)
    assert recording.ground_truth is not None
    tracking = PRESETS[recording.dataset].tracking
    if orb:
        tracking = replace(tracking, features=replace(tracking.features, kind="orb"))
    params = tracker_params(recording.camera, tracking)
    numbers = range(0, len(recording), max(1, case.step // 2))
    found = [observe(params, recording[number]).keypoints.features for number in numbers]
    return recording.ground_truth.poses[list(numbers)], found


def shares_found(
    poses: Float[np.ndarray, "n 4 4"], signatures: Float[np.ndarray, "n d"]
) -> tuple[float, float]:
    """Shares of the frames that their most similar keyframe shows, and one of the four most similar ones.

    Args:
        poses: true poses, of keyframes and of frames by turns.
        signatures: of their images.
    """
    first, any_of = [], []
    for pose, signature in zip(poses[1::2], signatures[1::2], strict=True):
        near = np.linalg.norm(poses[::2, :3, 3] - pose[:3, 3], axis=1) < _METRES
        near &= poses[::2, :3, 2] @ pose[:3, 2] > _COSINE
        if near.any():
            best, _ = most_similar(signatures[::2], signature, _CANDIDATES)
            first.append(near[best[0]])
            any_of.append(near[best].any())
    return float(np.mean(first)), float(np.mean(any_of))


def search_ms(size: int) -> float:
    """Median time of a search among many signatures, ms.

    Args:
        size: of a signature.
    """
    signatures = np.random.default_rng(0).normal(size=(_MANY, size)).astype(np.float32)
    signatures /= np.linalg.norm(signatures, axis=1, keepdims=True)
    times = []
    for signature in signatures[:15]:
        begun = time.perf_counter()
        most_similar(signatures, signature, _CANDIDATES)
        times.append(time.perf_counter() - begun)
    return 1e3 * float(np.median(times))


def rows(names: list[str], *, orb: bool) -> Iterator[tuple[str, ...]]:
    """Rows of the table, one for each number of components.

    Args:
        names: of the cases.
        orb: whether the keypoints are those of ORB.
    """
    cases = [frames_of(CASES[name], orb=orb) for name in names]
    for components in _COMPONENTS:
        cells, size = [], components * (components + 1) // 2
        for poses, found in cases:
            signatures = np.stack([np.asarray(image_signature(f, components=components)) for f in found])
            cells.append(" / ".join(f"{100 * share:.1f}" for share in shares_found(poses, signatures)))
        yield (str(components), str(size), *cells, f"{search_ms(size):.0f}")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--sources", nargs="+", default=list(CASES), choices=list(CASES))
    parser.add_argument("--orb", action="store_true", help="ORB's keypoints instead of SuperFeats'")
    options = parser.parse_args()
    title = "Frames found, %: the most similar keyframe / one of the four most similar"
    columns = ("components", "size", *options.sources, "ms")
    print_table(title, columns, rows(options.sources, orb=options.orb))


if __name__ == "__main__":
    main()
