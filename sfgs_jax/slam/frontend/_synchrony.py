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

from sfgs_jax.geometry import Frame, has_depth
from sfgs_jax.sensors import colour_edges, depth_outlines, outline_agreement
from sfgs_jax.slam.state._synchrony import EDGE_STEP, FARTHEST_LAG, MAX_OUTLINES, Synchrony

_LEAST_FRAMES = 10
"""Frames below which nothing is said."""
_INDEPENDENT = 4
"""Frames that count as one: neighbours resemble each other."""
_CLEAR = 0.2
"""Least agreement at the best lag; where outlines belong together it is 0.3 to 3."""
_APART, _TOGETHER = 0.6, 0.9
"""Agreement at no lag, as a share of that at the best, below which a lag is believed, and above which it is
over. In recordings without the fault it stays above 0.7, and its median is 1."""
_SIGMAS = 4.5
"""Standard errors by which the best lag must fit better than none. In a corridor with few outlines it did so
by 4.0, without a fault."""


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
    size = synchrony.edges.shape[:0:-1]
    rgb, depth = (
        cv2.resize(np.asarray(image), size, interpolation=cv2.INTER_NEAREST)
        for image in (frame.rgb, frame.depth)
    )
    with np.errstate(invalid="ignore"):  # colours that are none show no edges
        grey = np.clip(cv2.transform(rgb, np.full((1, 3), 255 / 3)), 0, 255).astype(np.uint8)
    depth = np.ascontiguousarray(np.where(has_depth(depth), depth, 0), np.float32)
    found = depth_outlines(depth)
    found = found[:: max(1, -(-len(found) // MAX_OUTLINES))]
    padded = np.pad(found, ((0, MAX_OUTLINES - len(found)), (0, 0)), constant_values=-1).astype(np.int16)
    found_edges = colour_edges(grey)
    edges = np.rint((found_edges - found_edges.min()) / EDGE_STEP).astype(np.uint8)

    known = np.concatenate([np.asarray([len(found) > 0 and edges.any()]), synchrony.known[:-1]])
    after = replace(
        synchrony,
        edges=np.concatenate([edges[None], synchrony.edges[:-1]]),
        mean_edges=np.concatenate([np.asarray([edges.mean()], np.float32), synchrony.mean_edges[:-1]]),
        outlines=np.concatenate([padded[None], synchrony.outlines[:-1]]),
        known=known,
    )
    if not known.all():
        return after
    late = outline_agreement(after.edges, after.outlines[:1])[0] - after.mean_edges
    early = outline_agreement(after.edges[:1], after.outlines[1:])[:, 0] - after.mean_edges[0]
    row = (EDGE_STEP * np.concatenate([early[::-1], late])).astype(np.float32)
    judged = min(synchrony.num_judged + 1, len(synchrony.agreements))
    agreements = np.concatenate([row[None], synchrony.agreements[:-1]])
    lag = _lag(agreements[:judged], synchrony.lag, max_lag)
    return replace(after, agreements=agreements, num_judged=judged, lag=lag)


def _lag(rows: Float[np.ndarray, "f l"], before: int, max_lag: int) -> int:
    """The lag of depth by the newest frames; as before where they don't tell."""
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
