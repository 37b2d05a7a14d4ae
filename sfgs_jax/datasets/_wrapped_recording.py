"""A recording made of another one."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sfgs_jax.datasets._recording import Recording
from sfgs_jax.geometry import Camera, Frame, Trajectory


@dataclass(frozen=True)
class WrappedRecording:
    """A `Recording` that is another one in everything but what a subclass changes.

    Attributes:
        recording: the other one.
    """

    recording: Recording

    @property
    def name(self) -> str:
        """Name of the other one."""
        return self.recording.name

    @property
    def dataset(self) -> str:
        """Layout of the other one."""
        return self.recording.dataset

    @property
    def camera(self) -> Camera:
        """Camera of colour and depth."""
        return self.recording.camera

    @property
    def notes(self) -> tuple[str, ...]:
        """Warnings for the log."""
        return self.recording.notes

    @property
    def timestamps(self) -> Float[np.ndarray, " n"]:
        """Time of each frame in seconds, float64."""
        return self.recording.timestamps

    @property
    def ground_truth(self) -> Trajectory | None:
        """Known poses, `T_world_cam`."""
        return self.recording.ground_truth

    def __len__(self) -> int:
        return len(self.recording)

    def __getitem__(self, index: int) -> Frame:
        return self.recording[index]
