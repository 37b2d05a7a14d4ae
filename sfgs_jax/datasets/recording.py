"""What every source of RGB-D frames looks like to the rest of the system."""

from typing import Protocol, runtime_checkable

import numpy as np

from sfgs_jax.geometry import Camera, Frame, Trajectory


@runtime_checkable
class Recording(Protocol):
    """An RGB-D recording with random access to its frames.

    Frames are decoded when asked for. `recording[i]` gives host arrays in float32: colour in [0, 1], and
    depth in metres registered to the colour camera, 0 where it is missing. It raises `FrameError` for a
    frame that can't be used (truncated, unreadable, of another size); the
    recording stays usable.
    """

    @property
    def name(self) -> str:
        """Short name for logs and reports: the folder's name, or the source string of a synthetic one."""
        ...

    @property
    def dataset(self) -> str:
        """Layout: "tum", "7scenes", "replica", "icl_nuim", "scannet", "folder" or "synthetic"."""
        ...

    @property
    def camera(self) -> Camera:
        """The camera of colour and depth alike."""
        ...

    @property
    def timestamps(self) -> np.ndarray:
        """(N,) seconds, float64."""
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
