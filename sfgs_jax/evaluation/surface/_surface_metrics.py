"""Accuracy, completeness and F1 of a surface against a reference, both as points.

Source: Seitz et al., A comparison and evaluation of multi-view stereo reconstruction algorithms, 2006;
Knapitsch et al., Tanks and Temples, 2017 (precision, recall, F1).
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from sfgs_jax.arrays import InputError, checked


@dataclass(frozen=True)
class SurfaceFigures:
    """Agreement of a surface with a reference.

    Attributes:
        accuracy_m: mean distance of the found points from the nearest reference point, metres.
        completeness_m: mean distance of the reference points from the nearest found point, metres.
        precision: share of the found points that lie within the threshold of the reference.
        recall: share of the reference points that lie within the threshold of what was found.
        threshold_m: metres.
    """

    accuracy_m: float
    completeness_m: float
    precision: float
    recall: float
    threshold_m: float

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall; 0 if both are."""
        total = self.precision + self.recall
        return 2 * self.precision * self.recall / total if total else 0.0


@checked
def surface_figures(
    found: Float[np.ndarray, "n 3"], reference: Float[np.ndarray, "m 3"], *, threshold: float = 0.05
) -> SurfaceFigures:
    """Compare two surfaces by points on them, in one coordinate frame.

    Distances are those of nearest points, so both surfaces need samples closer together than the distances
    of interest; see `sample_triangles`. Points of a cloud may be given as they are.

    Args:
        found: points of the reconstruction, metres.
        reference: points of the reference, metres.
        threshold: largest distance of a point that counts as right, metres.

    Raises:
        InputError: a set of points is empty or not finite, or the threshold is not positive.
    """
    if not 0 < threshold < math.inf:
        raise InputError(f"The threshold must be a finite number of metres above 0, not {threshold!r}.")
    for name, points in (("found", found), ("reference", reference)):
        if not len(points) or not np.all(np.isfinite(points)):
            raise InputError(
                f"The {name} surface needs points with finite coordinates; it has {len(points)}."
            )
    to_reference, _ = KDTree(reference).query(found)
    to_found, _ = KDTree(found).query(reference)
    return SurfaceFigures(
        accuracy_m=float(np.mean(to_reference)),
        completeness_m=float(np.mean(to_found)),
        precision=float(np.mean(to_reference <= threshold)),
        recall=float(np.mean(to_found <= threshold)),
        threshold_m=threshold,
    )
