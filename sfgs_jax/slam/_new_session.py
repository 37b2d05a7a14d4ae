"""A map from before, to go on in with another recording of the same place."""

from dataclasses import replace

import equinox as eqx
import jax
import numpy as np

from sfgs_jax.arrays import InputError, checked
from sfgs_jax.geometry import HELD_OUT_EVERY
from sfgs_jax.sensors import FrameClock
from sfgs_jax.slam._graph_results import finish
from sfgs_jax.slam.config import SlamConfig
from sfgs_jax.slam.frontend import without_pose
from sfgs_jax.slam.state import SlamState, Tracker, empty_log, empty_synchrony


@checked
def new_session(state: SlamState, config: SlamConfig | None = None) -> SlamState:
    """The state before the first frame of another recording by the same camera, in the same place.

    Keyframes, Gaussians and what is known about the sensors stay. The camera may be anywhere: frames are lost
    until several in a row are recognised. Poses are in the world of the recording before. The log of frames
    begins anew; those from before have negative numbers.

    Args:
        state: after the last frame of the recording before.
        config: settings, if not the same; those of the refinement after the last frame may differ.

    Raises:
        InputError: the state has no keyframes, or other settings differ.
    """
    if not state.graph.keyframes:
        raise InputError("A map without keyframes has no place where another recording could go on.")
    config = config or state.config
    if not same_but_refinement(state.config, config):
        raise InputError("The map was made with other settings; a recording goes on in it with the same.")
    state = finish(state)
    # Whole cycles, so that the same frames as before count as held out.
    earlier = ((state.next_frame + 1) // HELD_OUT_EVERY + 1) * HELD_OUT_EVERY
    keyframes = tuple(replace(k, frame=k.frame - earlier) for k in state.graph.keyframes)
    views = tuple(replace(view, frame=view.frame - earlier) for view in state.mapping.views)
    return replace(
        state,
        config=config,
        tracker=lost(state.tracker, len(keyframes)),
        graph=replace(state.graph, keyframes=keyframes),
        mapping=replace(state.mapping, views=views),
        log=empty_log(),
        next_frame=0,
        clock=FrameClock(),
        last_view=state.last_view - earlier,
        synchrony=empty_synchrony(state.camera),
        num_lost=0,
    )


def same_but_refinement(a: SlamConfig, b: SlamConfig) -> bool:
    """Whether settings are the same, but for the length of the refinement after the last frame.

    Args:
        a: settings.
        b: settings.
    """
    ending = {name: getattr(b.mapping, name) for name in ("final_steps", "final_seconds")}
    return replace(a, mapping=replace(a.mapping, **ending)) == b


def lost(tracker: Tracker, num_keyframes: int) -> Tracker:
    """The tracker without a pose and without references.

    Args:
        tracker: before.
        num_keyframes: keyframes of the graph.
    """
    count = jax.device_put(np.asarray(num_keyframes, np.int32))
    return eqx.tree_at(lambda t: t.num_keyframes, without_pose(tracker), count)
