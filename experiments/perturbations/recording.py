"""A recording whose frames come in another order, at other times or with other images."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import Recording
from sfgs_jax.geometry import Camera, Frame, Trajectory

Severity = int | Literal["dynamic"]
"""1 to 5; "dynamic" draws one anew for each frame."""

Change = Callable[[Frame, int], Frame]
"""Gives a frame, numbered as in the perturbed recording, other images."""


def unchanged(frame: Frame, number: int) -> Frame:
    """The frame itself.

    Args:
        frame: of a recording.
        number: its number.
    """
    return frame


@dataclass(frozen=True)
class Perturbed:
    """A `Recording` made of the frames of another one.

    A frame's true pose is that of its colour image, whenever the image is shown.

    Attributes:
        recording: the recording as it was.
        colours: number of the frame that gives the colour, for each frame.
        depths: number of the frame that gives the depth, for each frame.
        timestamps: (n,) seconds, float64.
        change: of the images, after colour and depth are together.
        camera: intrinsics that the frames are said to have.
        disturbed: (n,) frames whose images say nothing about the pose.
    """

    recording: Recording
    colours: Int[np.ndarray, " n"]
    depths: Int[np.ndarray, " n"]
    timestamps: Float[np.ndarray, " n"]
    camera: Camera
    disturbed: Bool[np.ndarray, " n"]
    change: Change = field(default=unchanged, repr=False)

    @property
    def name(self) -> str:
        """Name of the recording as it was."""
        return self.recording.name

    @property
    def dataset(self) -> str:
        """Layout of the recording as it was."""
        return self.recording.dataset

    @property
    def notes(self) -> tuple[str, ...]:
        """Warnings for the log."""
        return self.recording.notes

    @property
    def poses(self) -> Float[np.ndarray, "n 4 4"]:
        """True `T_world_cam` of each frame, NaN where it is not known."""
        return true_poses(self.recording)[self.colours]

    @property
    def ground_truth(self) -> Trajectory | None:
        """The known poses."""
        poses = self.poses
        known = np.isfinite(poses).all((1, 2))
        return Trajectory(self.timestamps[known], poses[known]) if known.any() else None

    def __len__(self) -> int:
        return len(self.timestamps)

    def __getitem__(self, index: int) -> Frame:
        index = range(len(self))[index]
        colour = self.recording[int(self.colours[index])]
        depth = colour
        if self.depths[index] != self.colours[index]:
            depth = self.recording[int(self.depths[index])]
        time = float(self.timestamps[index])
        # A camera that delivers late does not know it, so depth has colour's time stamp.
        frame = Frame(np.asarray(colour.rgb), np.asarray(depth.depth), time, valid=colour.valid)
        return self.change(frame, index)


def whole(recording: Recording) -> Perturbed:
    """A recording with nothing changed, as the start of a perturbation.

    Args:
        recording: with or without ground truth.
    """
    numbers = np.arange(len(recording))
    nothing = np.zeros(len(recording), bool)
    return Perturbed(recording, numbers, numbers, recording.timestamps, recording.camera, nothing)


def selected(recording: Recording, frames: Int[np.ndarray, " n"]) -> Perturbed:
    """Some frames of a recording, in any order, with the time stamps that they had.

    Args:
        recording: any.
        frames: their numbers.
    """
    perturbed = whole(recording)
    return replace(
        perturbed,
        colours=frames,
        depths=frames,
        timestamps=recording.timestamps[frames],
        disturbed=np.zeros(len(frames), bool),
    )


def true_poses(recording: Recording) -> Float[np.ndarray, "n 4 4"]:
    """`T_world_cam` of each frame, NaN where there is none.

    Args:
        recording: any.
    """
    poses = np.full((len(recording), 4, 4), np.nan)
    truth = recording.ground_truth
    if truth is not None:
        _, frames, known = np.intersect1d(recording.timestamps, truth.timestamps, return_indices=True)
        poses[frames] = truth.poses[known]
    return poses


def generator(seed: int, number: int) -> np.random.Generator:
    """Random numbers of a frame, which do not depend on the frames before.

    Args:
        seed: of the perturbation.
        number: of the frame.
    """
    return np.random.default_rng([seed, number])


def at(values: tuple[float, ...], severity: Severity) -> float:
    """Value of a severity.

    Args:
        values: of severities 1 to 5.
        severity: one of them.

    Raises:
        InputError: there is no such severity, or it is "dynamic", which needs an image perturbation.
    """
    if severity not in range(1, 6):
        raise InputError(f"This perturbation has the severities 1 to 5, not {severity!r}.")
    return values[int(severity) - 1]
