"""Selection of frames of a recording, with a limit on depth."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets._options import ReaderOptions
from sfgs_jax.datasets._recording import Recording
from sfgs_jax.datasets._wrapped_recording import WrappedRecording
from sfgs_jax.geometry import Frame, Trajectory


def select(recording: Recording, options: ReaderOptions) -> "Selection":
    """Frames `start:end:stride` of a recording, with depth cut at `max_depth`.

    Args:
        recording: the whole recording.
        options: choice of frames, and the limit on depth.

    Raises:
        InputError: no frame is left.
    """
    frames = range(len(recording))[options.start : options.end : options.stride]
    if not frames:
        raise InputError(
            f"No frames of {recording.name} from {options.start} to {options.end or 'its end'}; "
            f"it has {len(recording)}."
        )
    return Selection(recording, frames, options.max_depth)


@dataclass(frozen=True)
class Selection(WrappedRecording):
    """A `Recording` of some frames of another one.

    Attributes:
        recording: the whole recording.
        frames: indices of the selected frames, ascending.
        max_depth: largest depth, metres; farther depth counts as missing, and None keeps everything.
    """

    frames: Sequence[int]
    max_depth: float | None

    @property
    def timestamps(self) -> Float[np.ndarray, " n"]:
        """Time of each selected frame in seconds, float64."""
        return self.recording.timestamps[self.frames]

    @property
    def ground_truth(self) -> Trajectory | None:
        """Known poses of the selected frames."""
        truth = self.recording.ground_truth
        if truth is None:
            return None
        selected = np.isin(truth.timestamps, self.timestamps)
        return truth[selected] if selected.any() else None

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: int) -> Frame:
        frame = self.recording[self.frames[index]]
        depth = np.asarray(frame.depth)
        if self.max_depth is not None:
            depth = np.where(depth <= self.max_depth, depth, np.float32(0))
        return Frame(frame.rgb, depth, frame.timestamp, frame.depth_timestamp, frame.valid)
