"""Tracking of a whole sequence: `lax.scan` over `track`, with a derivative of bounded memory."""

from functools import partial

import equinox as eqx
import jax
import jaxlie
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.arrays import InputError, checked
from sfgs_jax.slam.frontend._track import track
from sfgs_jax.slam.state._tracker import Tracker, TrackerParams
from sfgs_jax.superfeats import Features


class TrackedSequence(eqx.Module):
    """Poses of the frames of a sequence, and how they came about.

    Attributes:
        T_world_cam: their poses, stacked; the last known one where a frame was lost.
        source: a `PoseSource` of each.
        new_keyframe: whether the frame became a keyframe.
    """

    T_world_cam: jaxlie.SE3
    source: Int[Array, " n"]
    new_keyframe: Bool[Array, " n"]


@checked
def track_sequence(
    params: TrackerParams,
    tracker: Tracker,
    images: Float[Array | np.ndarray, "n H W"] | Float[Array | np.ndarray, "n H W 3"],
    depths: Float[Array | np.ndarray, "m H W"],
    elapsed: Float[Array | np.ndarray, " k"],
    features: Features | None = None,
    *,
    rematerialise: bool = True,
) -> tuple[Tracker, TrackedSequence]:
    """Find the poses of a sequence of frames, as one program that does not grow with their number.

    A pure function, like `track`: `vmap` over recordings, `grad` by everything that enters. The derivative
    passes from frame to frame through the keyframes that later frames are registered to.

    The reverse mode needs what each frame's forward pass computed. Rematerialisation keeps only the tracker
    between the frames and computes the rest again, so that a further frame needs the memory of one tracker.
    It costs a second forward pass. Forward modes have no need of it, and do not pay.

    Args:
        params: parameters of tracking.
        tracker: from `init_tracker` or an earlier call.
        images: colours or grey values in [0, 1].
        depths: metres along z; not finite or not positive counts as missing.
        elapsed: seconds since the frame before; 0 where unknown.
        features: keypoints of another extractor for each frame, stacked, instead of those of the network.
        rematerialise: whether the reverse mode keeps only the trackers; static.

    Raises:
        InputError: there are not as many images as depths and times.
    """
    counts = [len(x) for x in (images, depths, elapsed)]
    if len(set(counts)) > 1:
        raise InputError(
            "A sequence has an image, a depth and a time for each frame, not "
            f"{counts[0]} images, {counts[1]} depths and {counts[2]} times."
        )
    return _tracked(params, tracker, (images, depths, elapsed, features), rematerialise)


_Frames = tuple[Array, Array, Array, Features | None]


@partial(jax.jit, static_argnums=3)
def _tracked(
    params: TrackerParams, tracker: Tracker, frames: _Frames, rematerialise: bool
) -> tuple[Tracker, TrackedSequence]:
    def one_frame(tracker: Tracker, frame: _Frames) -> tuple[Tracker, tuple[jaxlie.SE3, Array, Array]]:
        tracker, info = track(params, tracker, *frame)
        return tracker, (info.T_world_cam, info.source, info.new_keyframe)

    # A loop's body is compiled once, so nothing could merge the two passes.
    step = jax.checkpoint(one_frame, prevent_cse=False) if rematerialise else one_frame
    tracker, found = lax.scan(step, tracker, frames)
    return tracker, TrackedSequence(*found)
