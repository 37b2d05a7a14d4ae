"""Frames that show the images of the frame before them.

A driver repeats its newest images when the next ones are late. The camera did not stand still meanwhile: by a
repeated frame it would seem to stop and then to jump. So such a frame is the one before it once more, and the
next frame's motion is from there.
"""

import equinox as eqx
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Bool, Float

from sfgs_jax.geometry import se3
from sfgs_jax.slam.state._frame_features import FrameFeatures
from sfgs_jax.slam.state._tracker import Tracker


def waiting_for(
    tracker: Tracker, seen: FrameFeatures, elapsed: Float[Array, ""]
) -> tuple[Tracker, Float[Array, ""]]:
    """The tracker as it waits for a frame, and the seconds that are to pass after that frame.

    If the frame repeats the one before, that is the tracker as it waited for that one.

    Args:
        tracker: after the frame before.
        seen: features of the frame.
        elapsed: seconds since the frame before; 0 if unknown.
    """
    again, motion = _is_repeated(seen, tracker), tracker.T_previous_current
    back = se3.compose(tracker.T_reference_cam, se3.inverse(motion)).wxyz_xyz
    T = jnp.where(again, back, tracker.T_reference_cam.wxyz_xyz)
    since = jnp.where(again, tracker.motion_seconds, tracker.since_tracked + elapsed)
    tracker = eqx.tree_at(lambda t: (t.T_reference_cam, t.since_tracked), tracker, (jaxlie.SE3(T), since))
    return tracker, jnp.where(again, elapsed, 0)


def _is_repeated(seen: FrameFeatures, tracker: Tracker) -> Bool[Array, ""]:
    """True if points and keypoints' scores are those of the newest frame, and its motion is known.

    Without keypoints nobody knows: two views along a bare wall may be the same.
    """
    last, follows = tracker.last, tracker.has_motion & (tracker.lost_in_a_row == 0)
    follows &= jnp.any(seen.keypoints.features.valid)
    pairs = (
        (seen.cloud.levels[0].points, last.cloud.levels[0].points),
        (seen.keypoints.features.scores, last.keypoints.features.scores),
    )
    return follows & jnp.all(jnp.stack([jnp.all(now == before) for now, before in pairs]))
