"""Gains of all frames, from those of the views."""

import numpy as np
from jaxtyping import Float

from sfgs_jax.slam.state._frame_log import FrameLog
from sfgs_jax.slam.state._map_state import View


def gains_of(log: FrameLog, views: tuple[View, ...]) -> Float[np.ndarray, "n 3"]:
    """Gain of each channel of the frames of a log, linear in time between the views.

    Args:
        log: the frames.
        views: of the map, with their gains.

    Returns:
        Gains relative to the mean of the views, which is how the map is optimised; 1 if there are no views.
    """
    rows = {number: row for row, number in enumerate(log.numbers.tolist())}
    known = sorted((rows[view.frame], view.gain.tolist()) for view in views if view.frame in rows)
    if not known:
        return np.ones((len(log.timestamps), 3))
    times, fitted = log.timestamps[[row for row, _ in known]], np.asarray([gain for _, gain in known])
    relative = fitted / fitted.mean(axis=0)
    return np.stack([np.interp(log.timestamps, times, gain) for gain in relative.T], axis=-1)
