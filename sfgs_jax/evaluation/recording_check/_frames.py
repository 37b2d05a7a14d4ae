"""Can the frames be read, in the order of their time stamps, and near enough to each other?"""

import itertools
from collections.abc import Sequence

import numpy as np

from sfgs_jax.evaluation.recording_check._finding import Finding
from sfgs_jax.evaluation.recording_check._frame_pairs import FramePair
from sfgs_jax.evaluation.recording_check._sample import RecordingSample

_MOST_UNREADABLE = 0.05
_REPEATED = 0.2
_LARGEST_SHIFT = 0.25
"""Median motion of keypoints from one frame to the next, in widths of the image."""


def check_frames(sample: RecordingSample) -> Finding:
    """Can the frames be read? The reader's options decide which there are.

    Args:
        sample: of the recording.
    """
    recording, tried = sample.recording, len(sample.frames) + len(sample.unreadable)
    share = len(sample.unreadable) / tried
    text = f"{len(recording)} frames of {recording.camera.width}x{recording.camera.height}, {tried} looked at"
    evidence = {"frames": len(recording), "unreadable share": share}
    if share <= _MOST_UNREADABLE:
        return Finding("frames", "good", text + ".", evidence=evidence)
    index, reason = next(iter(sample.unreadable.items()))
    return Finding(
        "frames",
        "warning",
        f"{text}: {100 * share:.0f} % of them can't be read; frame {index}: {reason}",
        "Copy or record these images again, or leave them out with --reader.start and --reader.end.",
        evidence,
    )


def check_times(sample: RecordingSample, pairs: Sequence[FramePair]) -> Finding:
    """Do time stamps rise, and are frames near enough to each other in space?

    Args:
        sample: of the recording.
        pairs: matched pairs of it.
    """
    steps = np.diff(sample.recording.timestamps)
    if not len(steps):
        return Finding("time stamps", "unknown", "One frame has no motion.")
    backwards, median = int(np.count_nonzero(steps <= 0)), float(np.median(steps))
    evidence = {"median step s": median, "steps not forward": backwards, "longest step s": float(steps.max())}
    if backwards > 0.01 * len(steps):
        return Finding(
            "time stamps",
            "warning",
            f"{backwards} of {len(steps)} frames are not later than the frame before them; times must rise.",
            "Correct the time stamps, or the file names that they are taken from.",
            evidence,
        )
    shifts = [pair.shift / (pair.second.index - pair.first.index) for pair in pairs]
    per_frame = float(np.median(shifts)) / sample.shape[1] if shifts else 0.0
    evidence["motion per frame widths"] = per_frame
    if per_frame > _LARGEST_SHIFT:
        return Finding(
            "time stamps",
            "warning",
            f"From frame to frame the image moves by {100 * per_frame:.0f} % of its width; "
            f"tracking expects less than {100 * _LARGEST_SHIFT:.0f} %.",
            "Record more frames a second, or move more slowly; with --reader.stride take a smaller step.",
            evidence,
        )
    return Finding("time stamps", "good", f"{1 / median:.3g} frames a second, rising.", evidence=evidence)


def check_repeats(sample: RecordingSample) -> Finding:
    """Is an image delivered twice while the other goes on, as by a camera of a lower rate?

    Args:
        sample: of the recording.
    """
    repeated = {"colour": 0, "depth": 0}
    total = 0
    for window in sample.windows:
        for before, after in itertools.pairwise(window):
            colour = np.array_equal(before.grey, after.grey)
            depth = before.depth_digest == after.depth_digest
            repeated["colour"] += colour and not depth
            repeated["depth"] += depth and not colour
            total += 1
    shares = {f"repeated {kind} share": count / max(1, total) for kind, count in repeated.items()}
    kind = max(repeated, key=lambda name: repeated[name])
    share = repeated[kind] / max(1, total)
    if share <= _REPEATED:
        return Finding("repeated images", "good", "Colour and depth are new in each frame.", evidence=shares)
    return Finding(
        "repeated images",
        "warning",
        f"{100 * share:.0f} % of the {kind} images are the same as the one before; each frame needs its own.",
        f"Record {kind} at the rate of the other camera, or keep only the frames with a new {kind} image.",
        shares,
    )
