"""Gains of all frames' colours and corrections of their poses, from those of the map's views."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from sfgs_jax.slam.state._frame_log import FrameLog
from sfgs_jax.slam.state._map_state import View
from sfgs_jax.slam.state._recordings import rows_by_recording


def gains_of(log: FrameLog, views: tuple[View, ...]) -> Float[np.ndarray, "n 3"]:
    """Gain of each channel of the frames of a log.

    Between two views the gain changes as the frames' brightness does. The difference that is left at the next
    view is shared out in time.

    Args:
        log: the frames, with their brightness.
        views: of the map, with their gains.

    Returns:
        Gains relative to the mean of the views, which is how the map is optimised; 1 if there are no views.
    """
    views = _logged(log, views)
    if not views:
        return np.ones((len(log.timestamps), 3))
    fitted = np.asarray([view.gain for view in views])
    rows = log.positions([view.frame for view in views])
    drift = np.log(fitted / fitted.mean(axis=0)) - log.brightness[rows]
    return np.exp(log.brightness + _in_time(log, views, drift))


def corrections_of(log: FrameLog, views: tuple[View, ...]) -> Float[np.ndarray, "n 6"]:
    """Tangents by which the views' images move the poses of the frames of a log, on the right.

    They are linear in time between the views. Neighbouring frames err alike: they were registered to the same
    keyframe.

    Args:
        log: the frames.
        views: of the map, with their corrections.
    """
    views = _logged(log, views)
    if not views:
        return np.zeros((len(log.timestamps), 6))
    return _in_time(log, views, np.asarray([view.correction for view in views]))


def _logged(log: FrameLog, views: Sequence[View]) -> tuple[View, ...]:
    """The views whose frames are in the log, in the order of their frames."""
    here = set(log.numbers.tolist())
    return tuple(sorted((view for view in views if view.frame in here), key=lambda view: view.frame))


def _in_time(
    log: FrameLog, views: Sequence[View], values: Float[np.ndarray, "v k"]
) -> Float[np.ndarray, "n k"]:
    """Values of the views at the times of the log's frames; 0 for a recording without views.

    Each recording has a time of its own.
    """
    at, found = log.positions([view.frame for view in views]), np.zeros((len(log.numbers), values.shape[1]))
    for rows in rows_by_recording(log):
        own = np.isin(at, rows)
        if own.any():
            times, now = log.timestamps[at[own]], log.timestamps[rows]
            found[rows] = np.stack([np.interp(now, times, column) for column in values[own].T], axis=-1)
    return found
