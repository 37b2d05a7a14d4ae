"""A box that cuts a part out of a map."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

# Corners by their bits; an edge joins two that differ in one bit.
_CORNERS = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)])
_EDGES = np.array([(i, i | 1 << bit) for i in range(8) for bit in range(3) if not i >> bit & 1])


@dataclass(frozen=True)
class Box:
    """A box along three axes.

    Attributes:
        axes: rows: the orthonormal axes, in world coordinates.
        low: least coordinate along each axis, metres.
        high: largest coordinate along each axis, metres.
    """

    axes: Float[np.ndarray, "3 3"]
    low: Float[np.ndarray, "3"]
    high: Float[np.ndarray, "3"]

    def contains(self, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Which points are inside, the faces included."""
        places = points @ self.axes.T
        return np.all((places >= self.low) & (places <= self.high), axis=1)

    def edges(self) -> Float[np.ndarray, "12 2 3"]:
        """The ends of the twelve edges, in world coordinates."""
        corners = np.where(_CORNERS, self.high, self.low) @ self.axes
        return corners[_EDGES]


def extent(
    points: Float[np.ndarray, "n 3"], axes: Float[np.ndarray, "3 3"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Least and largest coordinates of points along axes, rounded outwards to a decimetre.

    Args:
        points: world coordinates, metres; without any, a box of zero size.
        axes: rows: the axes.
    """
    if not len(points):
        return np.zeros(3), np.zeros(3)
    places = points @ axes.T.astype(points.dtype)
    return np.floor(10 * places.min(axis=0)) / 10, np.ceil(10 * places.max(axis=0)) / 10
