"""Are depth and colour of one time? A camera that delivers one of them late does not know it.

Poses from depth and colour of different times fit as well as others, and are wrong by what the camera moves
between the two. But the outlines of things in depth then lie beside those in colour, and along those in the
colour of some frames before or after. So outlines of the newest frames are compared at several lags. No unit
of depth, intrinsics or poses are needed.
"""

from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float, Int8, Shaped

from sfgs_jax.geometry import Frame, has_depth
from sfgs_jax.sensors import Outlines, colour_edges, depth_outlines, outline_agreement
from sfgs_jax.slam.state._synchrony import FARTHEST_LAG, MAX_OUTLINES, Synchrony

_LEAST_FRAMES = 10
"""Frames below which nothing is said."""
_INDEPENDENT = 4
"""Frames that count as one: neighbours resemble each other."""
_SURE, _LIKELY = 3.0, 2.5
"""Standard errors by which a lag must fit better than another to replace it. Frames are refused for a lag
that is sure; a likely one counts in covariances."""
_NEAR_SIDE = 1
"""Pixels by which outlines, found in what is near, lie beside the edges in colour."""
_BESIDE = (-2, -1, 0, 1, 2)
"""Pixels by which outlines of one time with the colours may lie beside their edges. A lag looks the same if
the camera moves slowly and all outlines have their near side on one side."""


def watched(synchrony: Synchrony, frame: Frame, max_lag: int) -> Synchrony:
    """What is known about the lag of depth after another frame.

    Args:
        synchrony: before the frame.
        frame: colour and depth.
        max_lag: frames by which depth may come late or early; `FARTHEST_LAG` or more looks at nothing.
    """
    if max_lag >= FARTHEST_LAG:
        return synchrony
    size = synchrony.edges.shape[2:0:-1]
    rgb, depth = (
        cv2.resize(np.asarray(image), size, interpolation=cv2.INTER_NEAREST)
        for image in (frame.rgb, frame.depth)
    )
    with np.errstate(invalid="ignore"):  # colours that are none show no edges
        grey = np.clip(cv2.transform(rgb, np.full((1, 3), 255 / 3)), 0, 255).astype(np.uint8)
    depth = np.ascontiguousarray(np.where(has_depth(depth), depth, 0), np.float32)
    found = depth_outlines(depth)
    found = found.every(max(1, -(-len(found.pixels) // MAX_OUTLINES))).moved(-_NEAR_SIDE)
    pixels, across = found.pixels.astype(np.int16), found.across
    missing = ((0, MAX_OUTLINES - len(pixels)), (0, 0))
    edges = colour_edges(grey)

    known = _with(synchrony.known, np.asarray(len(pixels) > 0 and edges.any()))
    after = replace(
        synchrony,
        edges=_with(synchrony.edges, edges),
        outlines=_with(synchrony.outlines, np.pad(pixels, missing, constant_values=-1)),
        across=_with(synchrony.across, np.pad(across, missing)),
        known=known,
    )
    if not known.all():
        return after
    late = outline_agreement(after.edges[1:], Outlines(after.outlines[:1], after.across[:1]))[0]
    in_time = _in_time(after.edges[:1], Outlines(after.outlines[0], after.across[0]))
    early = outline_agreement(after.edges[:1], Outlines(after.outlines[1:], after.across[1:]))[:, 0]
    row = np.concatenate([early[::-1], [in_time], late]).astype(np.float32)
    judged = min(synchrony.num_judged + 1, len(synchrony.agreements))
    agreements = _with(synchrony.agreements, row)
    rows = agreements[:judged]
    return replace(
        after,
        agreements=agreements,
        num_judged=judged,
        lag=_lag(rows, synchrony.lag, 0, _LIKELY),
        refused_lag=_lag(rows, synchrony.refused_lag, max_lag, _SURE),
    )


def _in_time(edges: Int8[np.ndarray, "1 h w 2"], outlines: Outlines) -> float:
    """Agreement of a frame's own outlines and edges, where they lie best."""
    beside = [outlines.moved(by) for by in _BESIDE]
    places = Outlines(np.stack([o.pixels for o in beside]), np.stack([o.across for o in beside]))
    return float(np.nanmax(outline_agreement(edges, places)))


def _lag(rows: Float[np.ndarray, "f l"], before: int, max_lag: int, num_sigmas: float) -> int:
    """The lag of depth by the newest frames, beyond that allowed; as before where they don't tell."""
    if len(rows) < _LEAST_FRAMES:
        return before
    none, best = FARTHEST_LAG, int(rows.mean(axis=0, dtype=np.float64).argmax())
    gains = rows[:, [best]].astype(np.float64) - rows
    sigmas = gains.std(axis=0) / np.sqrt(len(rows) / _INDEPENDENT)
    better = gains.mean(axis=0) > num_sigmas * sigmas
    if abs(best - none) > max_lag:
        allowed = slice(none - max_lag, none + max_lag + 1)
        return best - none if better[allowed].all() else before
    return 0 if better[none + before] else before


def _with(
    ring: Shaped[np.ndarray, "r ..."], newest: Shaped[np.ndarray, "..."]
) -> Shaped[np.ndarray, "r ..."]:
    """A ring after its newest entry; the oldest is gone."""
    return np.concatenate([newest[None], ring[:-1]])
