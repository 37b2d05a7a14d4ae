"""Markdown tables of the accuracy of motions and homographies from several extractors' matches."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import chain

import jax
import numpy as np

from experiments.extractors import Extractor
from experiments.warped_photos import WarpedPhoto
from sfgs_jax.evaluation import (
    accuracy,
    area_under_curve,
    corner_error,
    correct_matches,
    estimate_homography,
    estimate_motion,
    matching_score,
    pose_error,
    repeatability,
)
from sfgs_jax.superfeats import Features

Row = tuple[str, ...]

_ANGLES = (5.0, 10.0, 20.0)
_CORNER_PIXELS = (1.0, 3.0, 5.0)
TOTAL = "total"
"""Name of the group of all pairs."""
POSE_COLUMNS: Row = (
    "",
    "pairs",
    "group",
    *(f"Acc@{angle:.0f}" for angle in _ANGLES),
    *(f"AUC@{angle:.0f}" for angle in _ANGLES),
    "matches",
)
PLANE_COLUMNS: Row = (
    "",
    "pairs",
    "group",
    "repeatability",
    "matching score",
    "correct matches",
    *(f"corners@{pixels:.0f}" for pixels in _CORNER_PIXELS),
    "matches",
)


@dataclass(frozen=True)
class PoseSample:
    """One pair for relative pose.

    Attributes:
        group: row of the table.
        features: features of both images by an extractor, a function so that they can be kept between pairs.
        K_a: (3, 3) calibration matrix of image a.
        K_b: (3, 3) calibration matrix of image b.
        T_b_a: (4, 4) the true motion.
        turning: whether only the rotation counts, because the camera hardly moves.
    """

    group: str
    features: Callable[[Extractor], tuple[Features, Features]]
    K_a: np.ndarray
    K_b: np.ndarray
    T_b_a: np.ndarray
    turning: bool = False


@dataclass
class _PoseFigures:
    """Angular errors of pairs, one row a pair and one column a seed, and their numbers of matches."""

    errors: list[list[float]] = field(default_factory=list)
    counts: list[int] = field(default_factory=list)


def pose_table(samples: Iterable[PoseSample], extractors: Sequence[Extractor], *, seeds: int) -> list[Row]:
    """Rows under `POSE_COLUMNS`: accuracies with their standard deviations over RANSAC's seeds.

    Args:
        samples: the pairs.
        extractors: the methods to compare.
        seeds: number of RANSAC's runs on each pair.
    """
    found: dict[tuple[str, str], _PoseFigures] = {}
    for sample in samples:
        for extractor in extractors:
            a, b = extractor.matched(*sample.features(extractor))
            motions = [estimate_motion(a, b, sample.K_a, sample.K_b, seed=seed) for seed in range(seeds)]
            both = [pose_error(motion, sample.T_b_a) for motion in motions]
            errors = [error.rotation_deg if sample.turning else error.degrees for error in both]
            for group in {sample.group, TOTAL}:
                figures = found.setdefault((extractor.name, group), _PoseFigures())
                figures.errors.append(errors)
                figures.counts.append(len(a))
    rows = []
    names = [extractor.name for extractor in extractors]
    for (name, group), figures in sorted(
        found.items(), key=lambda item: (names.index(item[0][0]), item[0][1] == TOTAL)
    ):
        by_seed = np.asarray(figures.errors).T
        shares = 100 * np.array([accuracy(errors, _ANGLES) for errors in by_seed])
        areas = 100 * np.mean([area_under_curve(errors, _ANGLES) for errors in by_seed], axis=0)
        cells = [f"{m:.1f} ± {s:.1f}" for m, s in zip(shares.mean(axis=0), shares.std(axis=0), strict=True)]
        cells += [f"{area:.1f}" for area in areas]
        rows.append((name, str(len(figures.counts)), group, *cells, f"{np.mean(figures.counts):.0f}"))
    return rows


def plane_table(pairs: Iterable[WarpedPhoto], extractors: Sequence[Extractor]) -> list[Row]:
    """Rows under `PLANE_COLUMNS`; columns without a number in their names have a threshold of 3 pixels."""
    found: dict[tuple[str, str], list[tuple[float, ...]]] = {}
    for pair in pairs:
        for extractor in extractors:
            found.setdefault((extractor.name, pair.group), []).append(_plane_figures(pair, extractor))
    rows = []
    names = [extractor.name for extractor in extractors]
    for (name, group), figures in sorted(found.items(), key=lambda item: names.index(item[0][0])):
        table = np.asarray(figures)
        shares = (*table[:, :3].mean(axis=0), *accuracy(table[:, 3], _CORNER_PIXELS))
        cells = [f"{100 * share:.1f}" for share in shares]
        rows.append((name, str(len(table)), group, *cells, f"{table[:, 4].mean():.0f}"))
    return rows


def _plane_figures(pair: WarpedPhoto, extractor: Extractor) -> tuple[float, ...]:
    """Repeatability, matching score, share of correct matches, corner error, number of matches."""
    height, width = pair.image_a.shape[:2]
    shape_a = height, width
    height, width = pair.image_b.shape[:2]
    shape_b = height, width
    a, b = (jax.device_get(extractor.extract(image)) for image in (pair.image_a, pair.image_b))
    points_a, points_b = extractor.matched(a, b)
    every_a, every_b = (np.asarray(x.keypoints[x.valid], np.float64) for x in (a, b))
    correct = correct_matches(points_a, points_b, pair.H_b_a)
    return (
        repeatability(every_a, every_b, pair.H_b_a, shape_a, shape_b),
        matching_score(points_a, points_b, every_a, every_b, pair.H_b_a, shape_a, shape_b),
        float(correct.mean()) if len(correct) else 0.0,
        corner_error(estimate_homography(points_a, points_b), pair.H_b_a, shape_a),
        float(len(correct)),
    )


def print_table(title: str, columns: Row, rows: Iterable[Row]) -> None:
    """Print a table under its title, each row as it comes."""
    print(f"\n{title}\n")
    for row in chain((columns, tuple("---" for _ in columns)), rows):
        print("| " + " | ".join(row) + " |", flush=True)
