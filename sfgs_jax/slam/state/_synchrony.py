"""What the newest frames say about the time between depth and colour."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from sfgs_jax.arrays import pytree
from sfgs_jax.geometry import Camera

FARTHEST_LAG = 5
"""Most frames by which depth is tried earlier or later."""
MAX_OUTLINES = 500
"""Pixels of outlines that are kept of an image."""
WINDOW = 40
"""Frames that are judged together."""
_WIDTH = 320
"""Width that images are reduced to, by a whole factor."""


@pytree
@dataclass(frozen=True, eq=False)
class Synchrony:
    """Outlines of the newest frames, and how well those in depth lie on those in colour, by lag.

    Rings and table begin with the newest frame.

    Attributes:
        edges: (r, h, w, 2) of `sensors.colour_edges`, in a fraction of the image's size.
        outlines: (r, n, 2) pixels of `sensors.depth_outlines` there; -1 where there are fewer.
        across: (r, n, 2) their directions; 0 where there are fewer.
        known: (r,) frames that have both.
        agreements: (f, l) agreement of depth with colour by lag, for the newest frames that can be judged.
            The middle column is that of one time; those after it are of late depth.
        num_judged: rows of it that are filled.
        lag: frames by which depth comes late, negative if it comes early; 0 while the two are of one time,
            as far as can be told.
        refused_lag: the same, 0 while it may be one that is allowed.
    """

    edges: Int8[np.ndarray, "r h w 2"]
    outlines: Int[np.ndarray, "r n 2"]
    across: Float[np.ndarray, "r n 2"]
    known: Bool[np.ndarray, " r"]
    agreements: Float[np.ndarray, "f l"]
    num_judged: int
    lag: int
    refused_lag: int


def empty_synchrony(camera: Camera) -> Synchrony:
    """Before the first frame.

    Args:
        camera: intrinsics of the frames.
    """
    ring, factor = FARTHEST_LAG + 1, lag_factor(camera)
    return Synchrony(
        edges=np.zeros((ring, *(-(-side // factor) for side in camera.shape), 2), np.int8),
        outlines=np.full((ring, MAX_OUTLINES, 2), -1, np.int16),
        across=np.zeros((ring, MAX_OUTLINES, 2), np.float32),
        known=np.zeros(ring, bool),
        agreements=np.zeros((WINDOW, 2 * FARTHEST_LAG + 1), np.float32),
        num_judged=0,
        lag=0,
        refused_lag=0,
    )


def lag_factor(camera: Camera) -> int:
    """Whole factor by which the images are reduced to be looked at.

    Args:
        camera: intrinsics of the frames.
    """
    return max(1, round(camera.width / _WIDTH))
