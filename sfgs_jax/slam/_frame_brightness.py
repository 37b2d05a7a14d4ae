"""Brightness of a frame against the one before it."""

import jaxlie
import numpy as np
from jaxtyping import Float

from sfgs_jax.geometry import Frame, se3
from sfgs_jax.sensors import block_means, brightness_change
from sfgs_jax.slam.state import SlamState

_BRIGHTEST = 1e6
"""Of a colour; those of a recording end at 1."""


def look_of(
    state: SlamState, frame: Frame, keyframe: int, T_keyframe_cam: jaxlie.SE3
) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "3"]]:
    """A tracked frame's mean colours by blocks, and the change of its logarithmic brightness.

    Args:
        state: the run, whose graph knows the frame's keyframe and whose log ends with the frame before.
        frame: the frame.
        keyframe: number of its keyframe.
        T_keyframe_cam: its pose there.
    """
    log, look = state.log, block_means(np.asarray(frame.rgb))
    # Colours that are not finite, or negative, have no brightness.
    look = np.clip(np.nan_to_num(look, posinf=0.0), 0, _BRIGHTEST)
    if not len(log.timestamps) or not state.config.mapping.optimisation.estimate_exposure:
        return look, np.zeros(3, np.float32)
    keyframes = [int(log.keyframes[-1]), keyframe]
    motions = np.stack([log.motions[-1], np.asarray(T_keyframe_cam.wxyz_xyz)])
    before, now = se3.matrices_of(state.graph.poses[keyframes]) @ se3.matrices_of(motions)
    depth, seen = np.asarray(frame.depth), np.asarray(frame.mask)
    return look, brightness_change(
        state.last_look, look, depth, seen, state.camera, np.linalg.inv(before) @ now
    )
