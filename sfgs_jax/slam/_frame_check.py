"""Check of a frame before a step works on it."""

from typing import Any

from sfgs_jax.arrays import FrameError, InputError, described
from sfgs_jax.geometry import LONGEST_BREAK_S, Camera, Frame


def check_frame(frame: Any, camera: Camera, last_timestamp: float) -> None:
    """Raise an error unless a frame fits the camera and the clock.

    Args:
        frame: of whatever type a caller passed.
        camera: of the run.
        last_timestamp: of the frame before, seconds; NaN before the first.

    Raises:
        InputError: it is no frame, or has another size than the camera.
        FrameError: its time stamp is before that of the last frame, or more than an hour after it.
    """
    if not isinstance(frame, Frame):
        raise InputError(f"A step takes a Frame(rgb, depth, timestamp), not {described(frame)}.")
    if frame.depth.shape != camera.shape or frame.rgb.shape != (*camera.shape, 3):
        raise InputError(
            f"The frame has colour {frame.rgb.shape} and depth {frame.depth.shape}, the camera is for images "
            f"of {camera.shape}: pass frames of one size, and init() a state for each size."
        )
    time = float(frame.timestamp)
    if time < last_timestamp:
        raise FrameError(
            f"The frame's time stamp {time:.6f} s is before that of the last frame, {last_timestamp:.6f} s: "
            "pass frames in the order of their time stamps."
        )
    if time - last_timestamp > LONGEST_BREAK_S:
        raise FrameError(
            f"The frame's time stamp {time:.6f} s is more than an hour after that of the last frame, "
            f"{last_timestamp:.6f} s: time stamps are in seconds, and new_session() goes on after a break."
        )
