"""Are depth and colour of one time? A camera that delivers one of them late does not know it.

Poses from depth and colour of different times fit as well as others, and are wrong by what the camera moves
between the two. But the outlines of things in depth then lie beside those in colour, and on those in the
colour of some frames before or after. So outlines of the newest frames are compared at several lags. No unit
of depth, intrinsics or poses are needed.
"""

from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float

from sfgs_jax.geometry import Frame
from sfgs_jax.sensors import colour_edges, depth_outlines, outline_agreement
from sfgs_jax.slam.state._synchrony import FARTHEST_LAG, MAX_OUTLINES, Synchrony

_LEAST_FRAMES = 10
"""Frames below which nothing is said."""
_INDEPENDENT = 4
"""Frames that count as one: neighbours resemble each other."""
_CLEAR = 0.2
"""Least agreement at the best lag; where outlines belong together it is 0.3 to 3."""
_APART, _TOGETHER = 0.6, 0.9
"""Agreement at no lag, as a share of that at the best, below which a lag is believed, and above which it is
over. In recordings without the fault it stays above 0.7, and its median is 1."""
_SIGMAS = 4.0
"""Standard errors by which the best lag must fit better than none."""


def watched(synchrony: Synchrony, frame: Frame, max_lag: int) -> Synchrony:
    """What is known about the lag of depth after another frame.

    Args:
        synchrony: before the frame.
        frame: colour and depth.
        max_lag: frames by which depth may come late or early without a word; `FARTHEST_LAG` or more looks at
            nothing.
    """
    if max_lag >= FARTHEST_LAG:
        return synchrony
    factor = -(-frame.depth.shape[1] // synchrony.edges.shape[2])
    rgb, depth = np.asarray(frame.rgb)[::factor, ::factor], np.asarray(frame.depth)[::factor, ::factor]
    grey = np.clip(cv2.transform(rgb, np.full((1, 3), 255 / 3)), 0, 255).astype(np.uint8)
    depth = np.ascontiguousarray(np.where(np.isfinite(depth) & (depth > 0), depth, 0), np.float32)
    found = depth_outlines(depth)
    found = found[:: max(1, -(-len(found) // MAX_OUTLINES))]
    padded = np.pad(found, ((0, MAX_OUTLINES - len(found)), (0, 0)), constant_values=-1).astype(np.int16)
    edges = colour_edges(grey).astype(np.float16)

    known = np.concatenate([[len(found) > 0 and edges.any()], synchrony.known[:-1]])
    after = replace(
        synchrony,
        edges=np.concatenate([edges[None], synchrony.edges[:-1]]),
        outlines=np.concatenate([padded[None], synchrony.outlines[:-1]]),
        known=known,
    )
    if not known.all():
        return after
    late = outline_agreement(after.edges, after.outlines[:1])[0]
    early = outline_agreement(after.edges[:1], after.outlines[1:])[:, 0]
    row = np.concatenate([early[::-1], late]).astype(np.float32)
    agreements = np.concatenate([row[None], synchrony.agreements[:-1]])
    return replace(after, agreements=agreements, lag=_lag(agreements, synchrony.lag, max_lag))


def _lag(agreements: Float[np.ndarray, "f l"], before: int, max_lag: int) -> int:
    """The lag of depth by the newest frames; as before where they don't tell."""
    rows = agreements[np.isfinite(agreements).all(axis=1)]
    if len(rows) < _LEAST_FRAMES:
        return before
    means = rows.mean(axis=0, dtype=np.float64)
    best, none = int(means.argmax()), FARTHEST_LAG
    peak, now, lag = means[best], means[none], best - none
    if peak < _CLEAR:
        return before
    gains = (rows[:, best] - rows[:, none]).astype(np.float64)
    sigma = gains.std() / np.sqrt(len(rows) / _INDEPENDENT)
    if abs(lag) > max_lag and now < _APART * peak and gains.mean() > _SIGMAS * sigma:
        return lag
    return 0 if now > _TOGETHER * peak else before
