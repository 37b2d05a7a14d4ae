"""Pose of a frame by the tracker: whether its sensors agree, where it is, and how well that is known."""

from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from sfgs_jax.geometry import Frame, se3
from sfgs_jax.slam.frontend import (
    Found,
    TrackInfo,
    begin_tracking,
    find_frame,
    lost_unseen,
    watched,
)
from sfgs_jax.slam.keyframes import motion_covariance, revisited
from sfgs_jax.slam.state import PoseSource, SlamState, StepInfo, Tracker, lost_info


class FoundFrame(NamedTuple):
    """A frame that was looked for.

    Attributes:
        state: the run with the tracker after the frame; graph, log and map are as before.
        found: where it was found, None if it was not.
        info: the report, without what the graph adds.
        covariance: (6, 6) of its pose in its reference; infinite if it was not found.
        by_lag: (6, 6) the part of it by which depth is of another time. A keyframe is where its depth is.
    """

    state: SlamState
    found: Found | None
    info: StepInfo
    covariance: Float[np.ndarray, "6 6"]
    by_lag: Float[np.ndarray, "6 6"]


def find_pose(state: SlamState, frame: Frame, number: int) -> FoundFrame:
    """Look for a frame.

    Args:
        state: the run so far.
        frame: the next frame.
        number: its number in its source.
    """
    params, graph = state.params, state.graph
    before, clock = state.tracker, state.clock.after(float(frame.timestamp))
    tracked = begin_tracking(params, before, frame, clock.elapsed)
    # In the time that it takes.
    synchrony = watched(state.synchrony, frame, params.config.max_depth_lag)
    state = replace(state, synchrony=synchrony, next_frame=number + 1, clock=clock)
    if synchrony.refused_lag:
        return _lost(state, lost_unseen(before, clock.elapsed), _late(synchrony.refused_lag))
    if state.graph.focal.is_beyond(params.config.max_focal_error):
        return _lost(state, lost_unseen(before, clock.elapsed), _wrong_focal_lengths(state))
    found = find_frame(params, before, tracked, frame, clock.elapsed, graph, state.config.graph)
    found = revisited(params, found, graph, state.config.graph)
    info = _info(found)
    if not info.tracked:
        return _lost(state, found.tracker, _contradiction(found.info, found.tracker), info)
    covariance, by_lag = _covariance(state, found), _covariance_by_lag(state, found.tracker)
    begins = found.begins_map or not graph.keyframes
    if not begins and _is_beyond(covariance + by_lag, params.config.max_position_sigma):
        told = "" if _is_beyond(covariance, params.config.max_position_sigma) else _late(synchrony.lag)
        return _lost(state, lost_unseen(before, clock.elapsed), told, info)
    return FoundFrame(replace(state, tracker=found.tracker), found, info, covariance + by_lag, by_lag)


def _lost(state: SlamState, tracker: Tracker, told: str, info: StepInfo | None = None) -> FoundFrame:
    state = replace(state, tracker=tracker, num_lost=state.num_lost + 1)
    lost, unknown = lost_info(state.T_world_cam), np.diag(np.full(6, np.inf))
    if info is not None:
        # These figures show how little was missing.
        names = ("inlier_fraction", "rmse", "num_matches", "num_inliers")
        lost = lost._replace(**{name: getattr(info, name) for name in names})
    return FoundFrame(state, None, lost._replace(contradiction=told), unknown, unknown)


def _contradiction(info: TrackInfo, tracker: Tracker) -> str:
    """Why a lost frame's depth is not believed; empty if nothing speaks against it."""
    if not bool(tracker.doubtful_scale):
        return ""
    change = -100 * float(info.registration.scale_change)
    word = "longer" if change > 0 else "shorter"
    return f"Depth is about {abs(change):.0f} % {word} than in the frames before."


def _late(lag: int) -> str:
    """The sentence that says how late depth comes."""
    frames = f"{abs(lag)} frame{'s' if abs(lag) > 1 else ''}"
    return f"Depth comes {frames} {'late' if lag > 0 else 'early'} against colour."


def _wrong_focal_lengths(state: SlamState) -> str:
    """The sentence that says which focal lengths fit better."""
    camera, ratio = state.camera, float(np.exp(state.graph.focal.estimate()[0]))
    word, off = "long" if ratio < 1 else "short", 100 * abs(1 / ratio - 1)
    fits, given = (f"fx {s * camera.fx:.1f} and fy {s * camera.fy:.1f}" for s in (ratio, 1.0))
    return f"Focal lengths are about {off:.1f} % too {word}: what keyframes see fits {fits}, and not {given}."


def _covariance(state: SlamState, found: Found) -> Float[np.ndarray, "6 6"]:
    """Covariance of a pose in its reference. The longer the motion model carries it, the larger it is."""
    frames = max(1, int(found.tracker.motion_model_frames))
    free_sigma = state.config.tracking.motion_model_sigma * frames**0.5
    return motion_covariance(found.info.registration, state.graph.noise, free_sigma)


def _covariance_by_lag(state: SlamState, tracker: Tracker) -> Float[np.ndarray, "6 6"]:
    """Covariance of a pose by the camera's motion between depth and colour, as far as it is not estimated.

    Args:
        state: with what is known about the lag of depth.
        tracker: after the frame.

    Returns:
        (6, 6) of the tangent; zeros if depth is in time.
    """
    lag, period = state.synchrony.lag, state.clock.period
    if lag and period > 0:
        # Depth that is late was exposed before colour's stamp. Less than a frame is left to the estimate,
        # which may still be finding it; where times are not estimated it is zero.
        lag = int(lag + float(tracker.last_motion.timing.depth_delay) / period)
    if not lag:
        return np.zeros((6, 6))
    # The motion to a frame that was found by its looks is unknown.
    tracker = tracker if bool(tracker.has_motion) else state.tracker
    motion = se3.matrices_of(np.asarray(tracker.T_previous_current.wxyz_xyz)[None])
    frames = max(1.0, float(tracker.motion_seconds) / period) if period > 0 else 1.0
    moved = lag / frames * se3.logs_of(motion)[0]
    return np.outer(moved, moved)


def _is_beyond(covariance: Float[np.ndarray, "6 6"], position_sigma: float) -> bool:
    return bool(np.sqrt(np.trace(covariance[:3, :3])) > position_sigma)


def _info(ladder: Found) -> StepInfo:
    """The report once a frame has been tracked; one transfer from the device."""
    found, by = ladder.info, ladder.info.registration
    wanted = (found.source, found.new_keyframe, by.inlier_fraction, by.rmse, by.matched.num_matches)
    source, new_keyframe, fraction, rmse, matches, inliers = jax.device_get((*wanted, by.matched.num_inliers))
    return lost_info(found.T_world_cam)._replace(
        tracked=int(source) != PoseSource.LOST,
        source=PoseSource(int(source)),
        relocalised=ladder.by_looks,
        new_keyframe=bool(new_keyframe),
        new_map=ladder.begins_map,
        inlier_fraction=float(fraction),
        rmse=float(rmse),
        num_matches=int(matches),
        num_inliers=int(inliers),
    )
