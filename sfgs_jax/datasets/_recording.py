"""The recording protocol: the interface of every source of RGB-D frames."""

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from sfgs_jax.geometry import Camera, Frame, Trajectory


@runtime_checkable
class Recording(Protocol):
    """An RGB-D recording with random access to its frames.

    Frames are decoded when asked for. `recording[i]` gives host arrays in float32. Colour is RGB in [0, 1].
    Depth is in metres, registered to the colour camera, and 0 where it is missing.

    A frame that can't be used (truncated, unreadable, of another size) raises `FrameError`; the recording
    stays usable.
    """

    @property
    def name(self) -> str:
        """Short name for logs and reports: the folder's name, or "synthetic"."""
        ...

    @property
    def dataset(self) -> str:
        """Layout, one of `LAYOUTS`."""
        ...

    @property
    def camera(self) -> Camera:
        """The camera of colour and depth alike."""
        ...

    @property
    def timestamps(self) -> Float[np.ndarray, " n"]:
        """Time of each frame in seconds, float64."""
        ...

    @property
    def ground_truth(self) -> Trajectory | None:
        """`T_world_cam` of the frames whose pose is known, at those frames' time stamps; or None."""
        ...

    @property
    def notes(self) -> tuple[str, ...]:
        """Warnings for the log, one sentence each."""
        ...

    def __len__(self) -> int: ...

    def __getitem__(self, index: int) -> Frame: ...
