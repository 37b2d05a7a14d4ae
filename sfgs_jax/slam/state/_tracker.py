"""The tracker: parameters and state of `track`, pytrees of fixed shapes."""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.arrays import Text, printed_fields
from sfgs_jax.geometry import Camera, se3
from sfgs_jax.gicp import DistanceNoise, RowMotion
from sfgs_jax.sensors import DepthCorrection, SensorTiming
from sfgs_jax.slam.config import TrackingConfig
from sfgs_jax.slam.state._frame_features import FrameFeatures
from sfgs_jax.slam.state._keyframe_graph import KeyframeGraph
from sfgs_jax.slam.state._registration import Registration
from sfgs_jax.slam.state._timing_information import TimingInformation
from sfgs_jax.superfeats.network import Network


class TrackingNoise(eqx.Module):
    """Standard deviations of what a registration measures. Its settings have them at the beginning.

    Attributes:
        detected: of a keypoint's place along each axis, as detected, pixels.
        pixels: of a match's place, by its patch if these are aligned.
        inverse_depth: of depth measured at a keypoint, 1/m.
        surface: of the distances between two surfaces.
    """

    detected: Float[Array, ""]
    pixels: Float[Array, ""]
    inverse_depth: Float[Array, ""]
    surface: DistanceNoise


class TrackerParams(eqx.Module):
    """Parameters of tracking; gradients reach all but the settings and `depth_root`.

    Attributes:
        camera: intrinsics of the frames.
        network: weights of the keypoint network; None where another extractor, or none, is used.
        timing: times of the camera's rows, as known before the first frame; used where
            `TrackingConfig.estimate_timing` is on.
        depth_correction: correction of every depth image; None changes nothing.
        depth_root: lower Cholesky factor of the covariance of its G parameters, as the keyframes so far show
            them; empty where they are not estimated.
        noise: of keypoints and surfaces.
        config: settings; static.
    """

    camera: Camera
    network: Network | None
    timing: SensorTiming
    depth_correction: DepthCorrection | None
    depth_root: Float[Array, "G G"]
    noise: TrackingNoise
    config: TrackingConfig = eqx.field(static=True)


class Reference(NamedTuple):
    """A keyframe that frames are registered to.

    Attributes:
        features: of the keyframe, rectified.
        motion: of its rows, by which they were rectified.
        pose: its `T_world_cam` as wxyz_xyz.
        keyframe: its number.
    """

    features: FrameFeatures
    motion: RowMotion
    pose: Float[Array | np.ndarray, "7"]
    keyframe: Int[Array | np.ndarray, ""]


class Suspicion(eqx.Module):
    """A place out of reach of the last pose where the newest frames, all of them lost, look like being.

    Attributes:
        pose: (7,) `T_world_cam` of the newest of them there, as wxyz_xyz.
        frames: frames in a row that were found there; 0 without such a place.
        unknown: frames since the newest tracked one, and since such a place, that would have been recognised
            in a known place, and were not.
    """

    pose: Float[Array | np.ndarray, "7"]
    frames: Int[Array | np.ndarray, ""]
    unknown: Int[Array | np.ndarray, ""]


class Tracker(eqx.Module):
    """State of the tracker after a frame.

    The references lie in a ring of fixed size, so that a sequence is a `lax.scan` and a batch of sequences a
    `vmap`. Keyframes count from 0 in the order in which they were taken.

    Attributes:
        references: features of the newest keyframes, stacked along a leading axis of R slots.
        reference_poses: (R, 7) their `T_world_cam` as wxyz_xyz.
        reference_keyframes: (R,) their keyframe numbers, -1 in an empty slot.
        reference_motions: motions of their rows, by which they were rectified; stacked like the features.
        current: slot of the reference that frames are registered to.
        num_keyframes: keyframes taken so far.
        T_reference_cam: pose of the newest tracked frame in the current reference.
        T_previous_current: motion between the two newest tracked frames; none if the newest was found by its
            looks.
        motion_seconds: duration of that motion; 0 where it is unknown.
        since_tracked: seconds since the newest tracked frame, up to the newest frame.
        last: features of the newest tracked frame that could become a keyframe, not rectified.
        last_motion: motion of its rows.
        last_registration: its registration to the current reference.
        has_last: whether there is such a frame, and it is no keyframe yet.
        has_motion: whether a motion was measured since the first frame, or the last that was lost or found by
            its looks.
        lost_in_a_row: frames since the newest tracked frame, all of them lost.
        motion_model_frames: newest frames in a row whose pose rests on the motion model in part.
        motion_model_travel: motion that the model added up to over these, metres or radians, the larger.
        doubtful_scale: whether the sensor seems to have changed its scale of depth since the newest tracked
            frame.
        timing: what the frames said about the times of the rows, and about depth's errors that look alike.
        suspicion: where the newest frames may be, if more of them confirm it.
    """

    references: FrameFeatures
    reference_poses: Float[Array, "r 7"]
    reference_keyframes: Int[Array, " r"]
    reference_motions: RowMotion
    current: Int[Array, ""]
    num_keyframes: Int[Array, ""]
    T_reference_cam: jaxlie.SE3
    T_previous_current: jaxlie.SE3
    motion_seconds: Float[Array, ""]
    since_tracked: Float[Array, ""]
    last: FrameFeatures
    last_motion: RowMotion
    last_registration: Registration
    has_last: Bool[Array, ""]
    has_motion: Bool[Array, ""]
    lost_in_a_row: Int[Array, ""]
    motion_model_frames: Int[Array, ""]
    motion_model_travel: Float[Array, ""]
    doubtful_scale: Bool[Array, ""]
    timing: TimingInformation
    suspicion: Suspicion

    def __repr__(self) -> str:
        several = self.reference_keyframes.ndim != 1
        return printed_fields(
            "Tracker",
            num_keyframes=self.num_keyframes,
            T_world_cam=self.reference_poses if several else Text(se3.text_of(self.T_world_cam)),
            lost_in_a_row=self.lost_in_a_row,
        )

    @property
    def keyframe_on_host(self) -> int:
        """Number of the keyframe that frames are registered to, -1 without one, without running a program."""
        return int(np.asarray(self.reference_keyframes)[np.asarray(self.current)])

    @property
    def T_world_cam(self) -> jaxlie.SE3:
        """Pose of the newest tracked frame; the identity before the first."""
        return _world_pose(self.reference_poses, self.current, self.T_reference_cam)

    @property
    def predicted_motion(self) -> jaxlie.SE3:
        """Constant-velocity motion from the newest tracked frame to the newest frame."""
        known = (self.motion_seconds > 0) & (self.since_tracked > 0)
        ratio = jnp.where(known, self.since_tracked / jnp.where(known, self.motion_seconds, 1), 1)
        scaled = se3.exp(ratio * se3.log(self.T_previous_current))
        # Steady frames keep the motion to the bit, and have the derivative of the others.
        same, moving = lax.stop_gradient((self.T_previous_current.wxyz_xyz, scaled.wxyz_xyz))
        return jaxlie.SE3(jnp.where(ratio == 1, same + (scaled.wxyz_xyz - moving), scaled.wxyz_xyz))


@partial(jax.jit, inline=True)
def _world_pose(poses: Float[Array, "r 7"], slot: Int[Array, ""], T_reference_cam: jaxlie.SE3) -> jaxlie.SE3:
    return se3.compose(jaxlie.SE3(poses[slot]), T_reference_cam)


def empty_tracker(
    features: FrameFeatures, registration: Registration, timing: TimingInformation, num_references: int
) -> Tracker:
    """The tracker before the first frame.

    Args:
        features: a frame's features, or their shapes.
        registration: a registration, or its shapes.
        timing: what is known about the times of the rows.
        num_references: slots of the ring.
    """
    # Made on the host: there, no shape needs a program of its own.
    zeros = jax.tree.map(lambda x: jax.device_put(np.zeros(x.shape, x.dtype)), (features, registration))
    dtype = features.cloud.levels[0].surface.dtype
    at_once = SensorTiming(*(_scalar(0, dtype) for _ in range(3)))
    still = RowMotion(jax.device_put(np.zeros(6, dtype)), at_once, _scalar(False, bool))
    ring = jax.tree.map(
        lambda x: jax.device_put(np.zeros((num_references, *x.shape), x.dtype)), (features, still)
    )
    identity = np.asarray([1, 0, 0, 0, 0, 0, 0], dtype)
    return Tracker(
        references=ring[0],
        reference_poses=jax.device_put(np.tile(identity, (num_references, 1))),
        reference_keyframes=jax.device_put(np.full(num_references, -1, np.int32)),
        reference_motions=ring[1],
        current=_scalar(0, np.int32),
        num_keyframes=_scalar(0, np.int32),
        T_reference_cam=jaxlie.SE3(jax.device_put(identity)),
        T_previous_current=jaxlie.SE3(jax.device_put(identity)),
        motion_seconds=_scalar(0, dtype),
        since_tracked=_scalar(0, dtype),
        last=zeros[0],
        last_motion=still,
        last_registration=zeros[1],
        has_last=_scalar(False, bool),
        has_motion=_scalar(False, bool),
        lost_in_a_row=_scalar(0, np.int32),
        motion_model_frames=_scalar(0, np.int32),
        motion_model_travel=_scalar(0, dtype),
        doubtful_scale=_scalar(False, bool),
        timing=timing,
        suspicion=Suspicion(jax.device_put(identity), _scalar(0, np.int32), _scalar(0, np.int32)),
    )


def _scalar(value: float | int | bool, kind: np.dtype | type) -> Array:
    return jax.device_put(np.asarray(value, kind))


@partial(jax.jit, inline=True)
def reference_at(tracker: Tracker, slot: Int[Array | np.ndarray, ""]) -> Reference:
    """The keyframe in a slot of the ring.

    Args:
        tracker: with a keyframe there.
        slot: of the ring; -1 is the one before the first, and so on.
    """
    slot = slot % tracker.reference_keyframes.shape[0]
    return jax.tree.map(lambda x: lax.dynamic_index_in_dim(x, slot, keepdims=False), _ring(tracker))


def with_reference(tracker: Tracker, new: Reference) -> Tracker:
    """The tracker with a keyframe as its current reference, in the oldest slot.

    Args:
        tracker: before.
        new: the keyframe.
    """
    slot = (tracker.current + 1) % tracker.reference_keyframes.shape[0]
    ring = jax.tree.map(lambda ring, x: ring.at[slot].set(x), _ring(tracker), new)
    return eqx.tree_at(lambda t: (*_ring(t), t.current), tracker, (*ring, slot))


def _ring(tracker: Tracker) -> Reference:
    """All slots of the ring, stacked."""
    return Reference(
        tracker.references,
        tracker.reference_motions,
        tracker.reference_poses,
        tracker.reference_keyframes,
    )


def with_graph_poses(tracker: Tracker, graph: KeyframeGraph) -> Tracker:
    """The tracker with its references where the graph has their keyframes now.

    Args:
        tracker: before.
        graph: that holds the keyframes.
    """
    keyframes = np.asarray(tracker.reference_keyframes)
    filled = keyframes >= 0
    poses = np.where(filled[:, None], graph.poses[np.maximum(keyframes, 0)], tracker.reference_poses)
    return replace(tracker, reference_poses=jax.device_put(poses))
