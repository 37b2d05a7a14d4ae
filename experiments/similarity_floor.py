"""Shares of right and wrong matches that a floor for descriptors' similarity keeps, for SuperFeats and XFeat.

    python -m experiments.similarity_floor

Photographs that no training saw are matched with warped views, sharp and with motion blur. A mutual nearest
neighbour is right if it lies within 3 pixels of the point that the homography gives. The default floor of
`superfeats.match` keeps the share of right matches in blurred views that XFeat's own floor keeps of XFeat's.
"""

import jax
import numpy as np

from experiments.extractors import make_extractor
from experiments.feature_matching import PLANE_KEYPOINTS, unseen_photos
from experiments.matching_tables import print_table
from experiments.warped_photos import warped_photos
from sfgs_jax.evaluation import correct_matches
from sfgs_jax.superfeats import match
from sfgs_jax.superfeats.training import motion_blur

FLOORS = (0.7, 0.72, 0.75, 0.78, 0.8, 0.82, 0.85)
BLUR = (5, 15)
"""Least and greatest length of motion blur, pixels."""


def main() -> None:
    """Print the table."""
    rng = np.random.default_rng(0)
    extractors = [
        make_extractor(n, max_keypoints=PLANE_KEYPOINTS, weights=None) for n in ("superfeats", "xfeat")
    ]
    found: dict[tuple[str, str], list[tuple[np.ndarray, np.ndarray]]] = {}
    for pair in warped_photos(unseen_photos(), count=60, seed=0):
        if pair.group != "viewpoint":
            continue
        for view, image_b in (("sharp", pair.image_b), ("blurred", motion_blur(rng, pair.image_b, BLUR))):
            for extractor in extractors:
                a, b = (jax.device_get(extractor.extract(image)) for image in (pair.image_a, image_b))
                matches = jax.device_get(match(a, b, min_similarity=0.0))
                points_a = np.asarray(a.keypoints, np.float64)[matches.valid]
                points_b = np.asarray(b.keypoints, np.float64)[matches.index_b[matches.valid]]
                right = correct_matches(points_a, points_b, pair.H_b_a)
                found.setdefault((extractor.name, view), []).append(
                    (matches.similarity[matches.valid], right)
                )
    rows = []
    for (name, view), parts in found.items():
        similarity, right = (np.concatenate(values) for values in zip(*parts, strict=True))
        for kind, chosen in (("right", similarity[right]), ("wrong", similarity[~right])):
            kept = (f"{100 * np.mean(chosen > floor):.1f}" for floor in FLOORS)
            rows.append((name, view, kind, str(len(chosen)), *kept))
    columns = ("", "view", "matches", "all", *(f"above {floor:g} %" for floor in FLOORS))
    print_table("Mutual nearest neighbours kept by a floor", columns, rows)


if __name__ == "__main__":
    main()
