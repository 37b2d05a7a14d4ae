"""Many starts of one recording: other first frames, both directions of time, fewer frames.

Ten starts overlap almost fully, so they show how much of an error is chance on this recording. They do not
replace other recordings.
"""

import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import ReaderOptions, Recording, Selection, WrappedRecording, open_recording
from sfgs_jax.geometry import Frame, Trajectory


@dataclass(frozen=True)
class InMemory(WrappedRecording):
    """A recording whose frames are decoded once and kept, 5 MB each at 640x480."""

    _frames: dict[int, Frame] = field(default_factory=dict, init=False, repr=False, compare=False)

    def __getitem__(self, index: int) -> Frame:
        if index not in self._frames:
            self._frames[index] = self.recording[index]
        return self._frames[index]


def in_memory(name: str, place: str, options: ReaderOptions) -> InMemory | None:
    """A recording whose frames are kept; None, with a line, if its data is not there.

    Args:
        name: that the line calls it by.
        place: of the recording, as `open_recording` takes it.
        options: of the reader.
    """
    if not place.startswith("synthetic") and not Path(place).exists():
        print(f"no {name}: there is no {place}", file=sys.stderr)
        return None
    return InMemory(open_recording(place, options=options))


@dataclass(frozen=True)
class Backward(WrappedRecording):
    """A recording from its last frame to its first.

    Time stamps are mirrored at the middle of the recording, so they increase, and gaps stay where they were.
    Depth that was exposed after colour now comes before it, and rows are read out from the bottom up.
    """

    @property
    def timestamps(self) -> Float[np.ndarray, " n"]:
        """Time of each frame in seconds, float64, increasing."""
        return self._mirrored(self.recording.timestamps)[::-1]

    @property
    def ground_truth(self) -> Trajectory | None:
        """Known poses at the mirrored times, in their order."""
        truth = self.recording.ground_truth
        return truth and Trajectory(self._mirrored(truth.timestamps)[::-1], truth.poses[::-1])

    def __getitem__(self, index: int) -> Frame:
        frame = self.recording[range(len(self))[::-1][index]]
        exposed = frame.depth_timestamp
        if exposed is not None:
            exposed = float(self._mirrored(np.float64(exposed)))
        return Frame(frame.rgb, frame.depth, float(self.timestamps[index]), exposed)

    def _mirrored(self, times: np.ndarray | np.float64) -> np.ndarray:
        first, last = self.recording.timestamps[[0, -1]]
        return np.asarray(first + last - times)


def start_of(recording: Recording, start: int, stride: int) -> Recording:
    """One start: every `stride`-th frame from frame `start` on, backward if `start` is odd.

    The offset counts frames of the whole recording, not of the selection. So at strides above one the starts
    see other frames, and none loses more of the way than `start` frames. An offset in strides would show all
    starts the same frames. Backward, the frames dropped are the last ones.

    Args:
        recording: the whole recording.
        start: number of the start, from 0.
        stride: frames from one selected frame to the next.

    Raises:
        InputError: no frame is left.
    """
    if start >= len(recording):
        raise InputError(f"Start {start} leaves none of {len(recording)} frames: take fewer starts.")
    directed = Backward(recording) if start % 2 else recording
    return Selection(directed, range(len(recording))[start::stride], None)


def true_poses(recording: Recording) -> Float[np.ndarray, "n 4 4"]:
    """(N, 4, 4) ground truth of every frame, NaN where it is not known."""
    poses = np.full((len(recording), 4, 4), np.nan)
    truth = recording.ground_truth
    if truth is not None:
        poses[np.isin(recording.timestamps, truth.timestamps)] = truth.poses
    return poses
