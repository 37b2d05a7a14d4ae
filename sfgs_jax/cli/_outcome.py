"""Whether a run that came to its end was a success, and a word on its scale."""

from typing import Any

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import Recording
from sfgs_jax.evaluation import ate
from sfgs_jax.geometry import Trajectory

_MOST_LOST = 0.1
"""Share of the frames that a run may lose."""
_SCALE_TOLERANCE = 1.2
"""Factor that the scale of a trajectory may be off by its own error."""


def failure_of(
    metrics: dict[str, Any], source: str, contradiction: str = "", *, confirming: int = 0
) -> str | None:
    """Why a run that came to its end is no success; None if it is one.

    Args:
        metrics: content of `metrics.json` of a run over all frames.
        source: the recording, as the command line named it.
        contradiction: why frames were not believed, as the run said it last; empty if it never did.
        confirming: first frames that were lost until a place of an earlier map was believed; no failure.
    """
    frames = metrics["frames"]
    lost, offered = frames["lost"], frames["total"] - frames["dropped"]
    advice = contradiction or f"`sfgs-jax check {source}` says what is wrong with the recording."
    if metrics["map"]["gaussians"] == 0:
        return f"The map is empty: no Gaussian was made of {offered} frames. {advice}"
    if lost - confirming >= _MOST_LOST * (offered - confirming):
        return f"{lost} of {offered} frames were lost, a tenth or more. {advice}"
    return None


def scale_warning(trajectory: Trajectory, recording: Recording) -> str | None:
    """A sentence if the recorded poses have another scale than the trajectory, by alignment in Sim(3).

    Args:
        trajectory: of a run.
        recording: its recording, with or without poses.
    """
    if recording.ground_truth is None:
        return None
    try:
        rigid = ate(trajectory, recording.ground_truth)
        similar = ate(trajectory, recording.ground_truth, with_scale=True)
    except InputError:
        # Too few of the frames have a recorded pose.
        return None
    scale = similar.alignment.scale
    if 1 / _SCALE_TOLERANCE < scale < _SCALE_TOLERANCE or similar.rmse_m > 0.5 * rigid.rmse_m:
        return None
    return (
        f"The recorded poses are {scale:.3g} times as large as the trajectory: "
        "the depth scale, or the unit of the poses, is wrong."
    )
