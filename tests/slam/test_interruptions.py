"""A run that is interrupted at a line of its driver goes on to the same end."""

import inspect
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any

import jax
import numpy as np
import pytest

from sfgs_jax import slam

NUM_FRAMES = 2
DRIVER = inspect.getmodule(slam.run)


class Interruption:
    """Raises KeyboardInterrupt at the n-th line of frames, of their end, and of the refinement."""

    def __init__(self, at: int) -> None:
        self.at, self.lines = at, 0

    def __call__(self, frame: FrameType, event: str, argument: Any) -> Callable | None:
        if Path(frame.f_code.co_filename).name != Path(str(DRIVER.__file__)).name:
            return None
        return self.count if frame.f_code.co_name in ("_advance", "_finish", "refine") else None

    def count(self, frame: FrameType, event: str, argument: Any) -> Callable:
        if event == "line":
            self.lines += 1
            if self.lines == self.at:
                raise KeyboardInterrupt
        return self.count


@pytest.fixture
def busy(config):
    """Settings that give each frame a view, and an end with two steps of refinement."""
    return replace(config, mapping=replace(config.mapping, view_interval=2, views_in_memory=1))


@pytest.fixture(autouse=True)
def no_warm_up(monkeypatch):
    """Programs are compiled when they are called first."""
    monkeypatch.setattr(DRIVER, "warm_up", lambda camera, config: None)


def interrupted(frames, camera, config, at):
    """A run that is interrupted at a line of its driver, and the number of lines it came to."""
    interruption = Interruption(at)
    sys.settrace(interruption)
    try:
        found = slam.run(frames, camera, config)
    finally:
        sys.settrace(None)
    return found, interruption.lines


def test_interrupted_anywhere_it_goes_on_to_the_same_end(room, frames, busy, tmp_path):
    offered = list(enumerate(frames[:NUM_FRAMES]))
    # Compiles the programs, which would take long while lines are counted.
    whole = slam.run(offered, room.camera, busy)
    _, lines = interrupted(offered, room.camera, busy, at=0)
    assert whole.is_finished
    assert whole.num_refined == busy.mapping.final_steps
    assert lines > 50
    expected = jax.tree.leaves(whole.state)
    # A share of the lines, spread over frames, their end and the refinement.
    for at in range(5, lines + 1, lines // 7):
        stopped, _ = interrupted(offered, room.camera, busy, at)
        assert stopped.interrupted, at
        assert len(stopped.state.log.numbers) == stopped.num_frames
        slam.save_run(stopped, tmp_path / str(at))
        again = slam.load_run(tmp_path / str(at), busy)
        found = slam.run(offered[again.num_frames :], room.camera, busy, resumed=again)
        assert (found.num_frames, found.num_refined) == (whole.num_frames, whole.num_refined), at
        for a, b in zip(jax.tree.leaves(found.state), expected, strict=True):
            np.testing.assert_array_equal(a, b, err_msg=str(at))
