"""Frames that are missing, black, frozen, repeated, out of order, or somewhere else: faults of the stream."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool

from experiments.perturbations.recording import Perturbed, Severity, at, generator, selected, whole
from sfgs_jax.datasets import Recording
from sfgs_jax.geometry import Frame

KEPT = (2, 3, 4, 6, 8)
"""One frame in so many is kept."""
SHARES = (0.1, 0.2, 0.3, 0.4, 0.5)
"""Share of the frames that are dropped, repeated, without depth or with a wrong time."""
STRETCHES = (3, 6, 10, 15, 20)
"""Frames that are black or frozen, from the middle on."""
GAPS = (5, 10, 20, 30, 40)
"""Frames that are jumped over by a camera that is carried away."""
_ELSEWHERE = 10
"""Frames that it stays there before it is put back."""


def every_kth(recording: Recording, severity: Severity, seed: int) -> Perturbed:
    """Faster motion: one frame in k."""
    return selected(recording, np.arange(0, len(recording), int(at(KEPT, severity))))


def dropped(recording: Recording, severity: Severity, seed: int) -> Perturbed:
    """A share of the frames, chosen at random, does not arrive."""
    return selected(recording, np.flatnonzero(~_chosen(recording, severity, seed)))


def duplicated(recording: Recording, severity: Severity, seed: int) -> Perturbed:
    """A share of the frames shows the images of the frame before, with a time of its own."""
    numbers = np.arange(len(recording))
    shown = np.maximum.accumulate(np.where(_chosen(recording, severity, seed), 0, numbers))
    return replace(whole(recording), colours=shown, depths=shown)


def frozen(recording: Recording, severity: Severity, seed: int) -> Perturbed:
    """One image stays for a stretch of frames, then the camera has moved on."""
    stretch = _stretch(recording, severity)
    numbers = np.arange(len(recording))
    shown = np.where(stretch, numbers[stretch][0], numbers)
    return replace(whole(recording), colours=shown, depths=shown)


def black(recording: Recording, severity: Severity, seed: int) -> Perturbed:
    """Colour is black for a stretch of frames; depth is there."""
    stretch = _stretch(recording, severity)

    def change(frame: Frame, number: int) -> Frame:
        return replace(frame, rgb=np.zeros_like(np.asarray(frame.rgb))) if stretch[number] else frame

    return replace(whole(recording), change=change)


def blind(recording: Recording, severity: Severity, seed: int) -> Perturbed:
    """Colour is black for a stretch of frames, and there is no depth."""
    stretch = _stretch(recording, severity)

    def change(frame: Frame, number: int) -> Frame:
        if not stretch[number]:
            return frame
        return replace(
            frame, rgb=np.zeros_like(np.asarray(frame.rgb)), depth=np.zeros_like(np.asarray(frame.depth))
        )

    return replace(whole(recording), change=change, disturbed=stretch)


def without_depth(recording: Recording, severity: Severity, seed: int) -> Perturbed:
    """A share of the frames, chosen at random, has no depth."""
    chosen = _chosen(recording, severity, seed)

    def change(frame: Frame, number: int) -> Frame:
        return replace(frame, depth=np.zeros_like(np.asarray(frame.depth))) if chosen[number] else frame

    return replace(whole(recording), change=change)


def out_of_order(recording: Recording, severity: Severity, seed: int) -> Perturbed:
    """A share of the frames comes after its successor, with the times of the exposures."""
    frames = np.arange(len(recording))
    for number in np.flatnonzero(_chosen(recording, severity, seed)):
        if number + 1 < len(frames) and frames[number] == number:
            frames[[number, number + 1]] = frames[[number + 1, number]]
    return selected(recording, frames)


def gap(recording: Recording, severity: Severity, seed: int) -> Perturbed:
    """The camera is covered, and carried on for a stretch of frames."""
    middle, end = _jump(recording, severity)
    numbers = np.arange(len(recording))
    return selected(recording, np.concatenate([numbers[:middle], numbers[end:]]))


def kidnapped(recording: Recording, severity: Severity, seed: int) -> Perturbed:
    """The camera is somewhere else from one frame to the next, and later back, at the rate of its frames."""
    middle, end = _jump(recording, severity)
    numbers = np.arange(len(recording))
    frames = np.concatenate([numbers[:middle], numbers[end : end + _ELSEWHERE], numbers[middle:]])
    period = float(np.median(np.diff(recording.timestamps)))
    times = recording.timestamps[0] + period * np.arange(len(frames))
    return replace(selected(recording, frames), timestamps=times)


def _chosen(recording: Recording, severity: Severity, seed: int) -> Bool[np.ndarray, " n"]:
    """A share of the frames, never the first."""
    chosen = generator(seed, 0).random(len(recording)) < at(SHARES, severity)
    chosen[0] = False
    return chosen


def _stretch(recording: Recording, severity: Severity) -> Bool[np.ndarray, " n"]:
    """Frames from the middle on."""
    numbers, middle = np.arange(len(recording)), len(recording) // 2
    return (numbers >= middle) & (numbers < middle + at(STRETCHES, severity))


def _jump(recording: Recording, severity: Severity) -> tuple[int, int]:
    """The middle, and the frame at the other side of the gap."""
    middle = len(recording) // 2
    return middle, min(middle + int(at(GAPS, severity)), len(recording) - 1)
