"""Runs of a few frames, made the same way for several tests."""

from dataclasses import replace

from sfgs_jax import Frame, slam
from sfgs_jax.datasets import SyntheticRecording


def run_of_five_keyframes(
    room: SyntheticRecording, frames: list[Frame], config: slam.SlamConfig
) -> slam.SlamState:
    """The run after five frames so far apart that each became a keyframe, none of them adjusted."""
    graph = replace(config.graph, adjustment_frames=100, return_to_keyframes=False)
    state = slam.init(room.camera, replace(config, graph=graph))
    for number, index in enumerate((0, 3, 5, 8, 10)):
        state, _ = slam.step(state, frames[index], number=number)
    return state
