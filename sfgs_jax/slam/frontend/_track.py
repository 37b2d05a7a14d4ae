"""Tracking of a frame: one pure function from images to a pose, compiled once per image size."""

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax import gicp
from sfgs_jax.arrays import checked
from sfgs_jax.geometry import Camera, se3
from sfgs_jax.sensors import SensorTiming
from sfgs_jax.slam.config import TrackingConfig
from sfgs_jax.slam.frontend._depth_scale import is_other_scale
from sfgs_jax.slam.frontend._frame_features import feature_shapes, frame_features
from sfgs_jax.slam.frontend._joint_registration import Allowed, extent, found_again, register
from sfgs_jax.slam.frontend._keyframe_choice import needs_keyframe, runs_out_of_keypoints
from sfgs_jax.slam.frontend._pose_source import images_look_alike, keypoints_are_alike, keypoints_are_sure
from sfgs_jax.slam.frontend._rectification import on_their_planes, rectified
from sfgs_jax.slam.frontend._repeated_frame import waiting_for
from sfgs_jax.slam.frontend._timing_estimate import timing_equations
from sfgs_jax.slam.state._frame_features import FrameFeatures
from sfgs_jax.slam.state._registration import PoseSource, Registration
from sfgs_jax.slam.state._timing_information import TimingPrior, no_timing_information
from sfgs_jax.slam.state._tracker import (
    Reference,
    Tracker,
    TrackerParams,
    empty_tracker,
    reference_at,
    with_reference,
)
from sfgs_jax.superfeats import Features

_BY_LAST = 2
"""Number of the first attempt that registers to the last frame instead of the reference."""
_STALE = 1e-3
"""Change of the times of the rows, seconds, from which on a reference is rectified anew. In a millisecond a
camera that turns by a radian a second moves its image by half a pixel."""
_MISSING = 1.5
"""Time since the last frame, in times between two frames, above which a frame between is missing."""


class TrackInfo(eqx.Module):
    """What happened to a frame.

    Attributes:
        T_world_cam: its pose; the last known one where it was lost.
        T_reference_cam: its pose in the keyframe that it was registered to.
        source: a `PoseSource`.
        registration: its registration, with the evidence.
        reference: number of the keyframe that it was registered to.
        bridged: whether the frame before it became a keyframe first, because the reference shared too little.
        new_keyframe: whether the frame became a keyframe.
        features: its features, not rectified; the tracker's references are.
    """

    T_world_cam: jaxlie.SE3
    T_reference_cam: jaxlie.SE3
    source: Int[Array, ""]
    registration: Registration
    reference: Int[Array, ""]
    bridged: Bool[Array, ""]
    new_keyframe: Bool[Array, ""]
    features: FrameFeatures

    @property
    def tracked(self) -> Bool[Array, ""]:
        """Whether the frame's pose is known."""
        return self.source != PoseSource.LOST


@checked
def init_tracker(params: TrackerParams) -> Tracker:
    """The tracker before the first frame, whose camera will be the world frame.

    Args:
        params: parameters of tracking.
    """
    features = feature_shapes(params)
    found = jax.eval_shape(register, params, features, features, se3.identity())
    timing = no_timing_information(len(params.depth_root), params.depth_root.dtype)
    return empty_tracker(features, found, timing, params.config.num_references)


@checked
@jax.jit
def track(
    params: TrackerParams,
    tracker: Tracker,
    image: Float[Array, "H W"] | Float[Array, "H W 3"],
    depth: Float[Array, "H W"],
    elapsed: Float[Array, ""],
    features: Features | None = None,
) -> tuple[Tracker, TrackInfo]:
    """Find a frame's pose in the current reference, and decide whether it becomes a keyframe.

    A pure function on pytrees of fixed shapes: `lax.scan` over frames, `vmap` over recordings. The pose is
    differentiable through the frame's last registration, by the implicit function theorem.

    A frame is registered from the motion model. If that fails, it is registered from the last pose, with
    keypoints matched by their looks alone. If both fail, the same is tried in the frame before, which then
    becomes a keyframe itself. If keypoints shared in the last pose and not in this one, all are tried until
    they do. If few of the matches agree, the last pose is tried too, and more inliers win.

    A frame that repeats the images of the one before it is that frame again.

    Args:
        params: parameters of tracking.
        tracker: from `init_tracker` or an earlier call.
        image: colours or grey values in [0, 1].
        depth: metres along z; not finite or not positive counts as missing.
        elapsed: seconds since the frame before, tracked or not; 0 if unknown.
        features: keypoints of another extractor, instead of those of the network.
    """
    seen = frame_features(params, image, depth, features)
    tracker, left = waiting_for(tracker, seen, elapsed)
    found, attempt = _first_success((params, tracker, seen))

    is_first = tracker.num_keyframes == 0
    begun = jnp.where(seen.registrable, int(PoseSource.JOINT), int(PoseSource.LOST))
    source = jnp.where(is_first, begun, found.source)
    bridged = (source != PoseSource.LOST) & (attempt >= _BY_LAST) & ~is_first
    before = tracker.T_world_cam
    tracker = lax.cond(bridged, lambda t: _pushed(t, last_as_reference(params, t)), lambda t: t, tracker)
    tracker, info = settle(params, tracker, seen, found, before=before, source=source)
    tracker = eqx.tree_at(lambda t: t.since_tracked, tracker, tracker.since_tracked + left)
    return tracker, eqx.tree_at(lambda i: i.bridged, info, bridged)


def settle(
    params: TrackerParams,
    tracker: Tracker,
    seen: FrameFeatures,
    found: Registration,
    *,
    before: jaxlie.SE3,
    source: Int[Array, ""],
    relocalised: Bool[Array, ""] | bool = False,
) -> tuple[Tracker, TrackInfo]:
    """The tracker after a frame was registered to its current reference, or lost.

    Args:
        params: parameters of tracking.
        tracker: with the reference that the frame was registered to; empty before the first frame.
        seen: features of the frame.
        found: its registration.
        before: `T_world_cam` of the newest tracked frame before it.
        source: a `PoseSource`.
        relocalised: whether the frame was found by its looks; then its motion is unknown.
    """
    is_first, tracked = tracker.num_keyframes == 0, source != PoseSource.LOST
    if params.config.features.align_patches:
        seen = _with_places(seen, found, params.camera)
    T = jnp.where(tracked & ~is_first, found.T_target_source.wxyz_xyz, tracker.T_reference_cam.wxyz_xyz)
    sweep = _sweep(params, tracker, tracker.T_reference_cam)
    # Without an estimate no motion is ever known, that of the last frame neither.
    motion = tracker.last_motion if sweep is None else sweep.at(jaxlie.SE3(T))
    # A pose that rests on the motion model in part would pass its error on to every later frame.
    firm = (source != PoseSource.MOTION_MODEL) & ~jnp.asarray(relocalised)
    could_be_keyframe = tracked & seen.registrable & firm
    wanted = needs_keyframe(found, params.config) | runs_out_of_keypoints(found, seen, params.config)
    # The first frame's motion was unknown, and its rows lie where they were read. So do those of the second,
    # which is off for that. The third has two motions behind it, and gives the next ones a true reference.
    wanted |= motion.known & tracker.has_motion & ~tracker.reference_motions.known[tracker.current]
    new_keyframe = could_be_keyframe & (is_first | wanted)
    tracker = _with_timing(params, tracker, seen, found, motion, tracked & ~is_first)
    tracker = _moved(tracker, before, jaxlie.SE3(T), source, relocalised)
    other = is_other_scale(found.scale_change, found.scale_sigma, params.config.max_scale_change)
    doubtful = ~tracked & (tracker.doubtful_scale | other)
    tracker = eqx.tree_at(lambda t: t.doubtful_scale, tracker, doubtful)
    info = TrackInfo(
        T_world_cam=tracker.T_world_cam,
        T_reference_cam=jaxlie.SE3(T),
        source=source,
        registration=found,
        reference=tracker.reference_keyframes[tracker.current],
        bridged=jnp.asarray(False),
        new_keyframe=new_keyframe,
        features=seen,
    )
    tracker = _with_rows_in_time(params, tracker, new_keyframe, seen, motion, info.T_world_cam)
    if params.config.estimate_timing:
        motion = replace(motion, timing=estimated_timing(params, tracker)[0])
    return _remembered(tracker, seen, motion, found, tracked, could_be_keyframe & ~new_keyframe), info


def _with_places(seen: FrameFeatures, found: Registration, camera: Camera) -> FrameFeatures:
    """Features of a frame with its keypoints where its registration has found them.

    So whoever is registered to the frame, and its landmarks, have the places of the keyframe before.
    """
    if seen.keypoints.depth.shape[0] == 0:
        return seen
    keypoints, matched = seen.keypoints, found.matched
    pixels = jnp.where((matched.inliers & found.by_keypoints)[:, None], matched.pixels, keypoints.places)
    return replace(seen, keypoints=replace(on_their_planes(keypoints, pixels, camera), places=pixels))


def lost_unseen(tracker: Tracker, elapsed: float) -> Tracker:
    """The tracker after a frame that was not even looked at; on the host.

    Args:
        tracker: before the frame.
        elapsed: seconds since the frame before, 0 if unknown.
    """
    since, lost = np.asarray(tracker.since_tracked), np.asarray(tracker.lost_in_a_row)
    after = np.asarray(since + elapsed, since.dtype), np.asarray(lost + 1, lost.dtype), np.asarray(False)
    return eqx.tree_at(
        lambda t: (t.since_tracked, t.lost_in_a_row, t.has_motion), tracker, jax.device_put(after)
    )


def allowed_sources(tracker: Tracker, config: TrackingConfig) -> Allowed:
    """Sources of the next frame's pose that the frames before allow.

    Args:
        tracker: before the frame.
        config: settings.
    """
    carried = tracker.motion_model_frames < config.max_motion_model_frames
    carried &= tracker.motion_model_travel <= config.max_motion_model_travel
    # Keypoints can still tell where a camera is that was lost for long; its surface can't.
    recent = tracker.lost_in_a_row <= config.max_lost
    has_keypoints = config.features.kind != "none"
    # The second frame may have moved in any way, and so may a lost one: that it stood still is a guess.
    return Allowed(
        surface=recent | (not has_keypoints),
        motion_model=carried & tracker.has_motion,
        near_guess=(tracker.lost_in_a_row == 0) & ~_misses_frames(tracker),
        doubtful_scale=tracker.doubtful_scale,
        images=~images_look_alike(tracker.last_registration.image_correlation, config, near_guess=False),
    )


def _misses_frames(tracker: Tracker) -> Bool[Array, ""]:
    """True if the time since the last frame says that others came between: they are like lost ones."""
    known = tracker.motion_seconds > 0
    return known & (tracker.since_tracked > _MISSING * tracker.motion_seconds)


def _starts(tracker: Tracker) -> Float[Array, "4 7"]:
    """Guesses of T_target_source as wxyz_xyz: two in the reference, two in the last frame."""
    motion = tracker.predicted_motion
    identity = se3.identity(motion.wxyz_xyz.dtype)
    in_reference = se3.compose(tracker.T_reference_cam, motion)
    guesses = (in_reference, tracker.T_reference_cam, motion, identity)
    return jnp.stack([T.wxyz_xyz for T in guesses])


_Inputs = tuple[TrackerParams, Tracker, FrameFeatures]
_Search = tuple[Registration, Int[Array, ""], Int[Array, ""]]
"""The registration kept, its attempt, and the next one."""


def _register_at(inputs: _Inputs, attempt: Int[Array, ""], found: Registration | None = None) -> Registration:
    """The registration of an attempt; one that was found before gets its derivatives."""
    params, tracker, seen = inputs
    by_last = attempt >= _BY_LAST
    target = lax.cond(
        by_last,
        lambda: last_as_reference(params, tracker),
        lambda: reference_at(tracker, tracker.current),
    )
    guess = jaxlie.SE3(_starts(tracker)[attempt])
    identity = se3.identity(guess.wxyz_xyz.dtype).wxyz_xyz
    before = jaxlie.SE3(jnp.where(by_last, identity, tracker.T_reference_cam.wxyz_xyz))
    # Two frames of a steady motion whose rows both lie where they were read fit as they are.
    sweep = _sweep(params, tracker, before, target.motion.known)
    # Where the motion model has failed, it does not say where keypoints should lie either. With a wrong guess
    # those are preferred that make another tile look like the right one.
    guess_known = attempt % 2 == 0
    allowed = allowed_sources(tracker, params.config)
    allowed = allowed._replace(near_guess=allowed.near_guess & guess_known)
    if found is not None:
        return found_again(
            params, seen, target.features, guess, allowed, sweep, found, guess_known=guess_known
        )
    found = register(params, seen, target.features, guess, allowed, sweep, guess_known=guess_known)
    predicted = jaxlie.SE3(_starts(tracker)[jnp.where(by_last, _BY_LAST, 0)])
    return _plausible(found, predicted, tracker, params.config)


def _plausible(
    found: Registration, predicted: jaxlie.SE3, tracker: Tracker, config: TrackingConfig
) -> Registration:
    """A registration, lost if its keypoints are not sure and the camera's velocity would change too much.

    Before the second frame, and after one found by its looks, no velocity is known. Then images tell instead.
    """
    off = jnp.linalg.norm(se3.compose(se3.inverse(predicted), found.T_target_source).translation())
    seconds = tracker.since_tracked
    jumps = (seconds > 0) & (off > config.max_velocity_change * seconds)
    unmeasured = ~tracker.has_motion & (tracker.lost_in_a_row == 0)
    alike = images_look_alike(found.image_correlation, config, near_guess=False)
    sure = keypoints_are_sure(found.matched, config.features) | (unmeasured & alike)
    unlikely = found.by_keypoints & jumps & ~sure
    source = jnp.where(unlikely, int(PoseSource.LOST), found.source)
    return eqx.tree_at(lambda f: f.source, found, source)


def _sweep(
    params: TrackerParams,
    tracker: Tracker,
    T_target_before: jaxlie.SE3,
    known: Bool[Array, ""] | bool = True,
) -> gicp.Sweep | None:
    """Motion of the newest frame while it was read; unknown after a lost frame, and if it is said to be."""
    if not params.config.estimate_timing:
        return None
    seconds = jnp.where(jnp.asarray(known) & (tracker.lost_in_a_row == 0), tracker.since_tracked, 0)
    timing = estimated_timing(params, tracker)[0]
    has_motion = tracker.has_motion & (tracker.motion_seconds > 0)
    twist = se3.log(tracker.T_previous_current) / jnp.where(has_motion, tracker.motion_seconds, 1)
    before = gicp.RowMotion(jnp.where(has_motion, twist, 0), timing, has_motion)
    return gicp.Sweep(T_target_before, seconds, timing, before)


@checked
@partial(jax.jit, inline=True)
def estimated_timing(params: TrackerParams, tracker: Tracker) -> tuple[SensorTiming, Float[Array, "3 3"]]:
    """Times of the camera's rows as the frames so far show them, and their covariance in s².

    Without `TrackingConfig.estimate_timing` these are the times known before the first frame.

    Args:
        params: parameters of tracking.
        tracker: after these frames.
    """
    sigmas = timing_prior(params).sigmas
    return tracker.timing.estimate(params.timing), tracker.timing.covariance(sigmas)


def timing_prior(params: TrackerParams) -> TimingPrior:
    """Prior of the times of the rows, and of depth's errors as the keyframes know them.

    Args:
        params: parameters of tracking.
    """
    config = params.config
    sigmas = jnp.asarray([config.delay_sigma, config.readout_sigma, config.readout_sigma])
    return TimingPrior(sigmas, params.depth_root)


def _with_timing(
    params: TrackerParams,
    tracker: Tracker,
    seen: FrameFeatures,
    found: Registration,
    motion: gicp.RowMotion,
    tracked: Bool[Array, ""],
) -> Tracker:
    """The tracker with what a frame's registration to its reference says about the times of the rows."""
    if not params.config.estimate_timing:
        return tracker
    target, by, *_ = reference_at(tracker, tracker.current)
    # A pose that rests on the motion model says how the camera was thought to move.
    told = tracked & motion.known & by.known & (found.source != PoseSource.MOTION_MODEL)
    new = timing_equations(*lax.stop_gradient((params, seen, target, found, motion, by)))
    before, prior = lax.stop_gradient((tracker.timing, timing_prior(params)))
    total = jax.tree.map(lambda a, b: jnp.where(told, a, b), before.plus(*new, prior), before)
    return eqx.tree_at(lambda t: t.timing, tracker, total)


@jax.jit
def last_as_reference(params: TrackerParams, tracker: Tracker) -> Reference:
    """The last frame, rectified for others to be registered to, as the keyframe that it would be.

    Args:
        params: parameters of tracking.
        tracker: after that frame.
    """
    features, motion = tracker.last, tracker.last_motion
    if params.config.estimate_timing:
        features = rectified(features, params.camera, motion)
    return Reference(features, motion, tracker.T_world_cam.wxyz_xyz, tracker.num_keyframes)


@eqx.filter_custom_jvp
def _first_success(inputs: _Inputs) -> tuple[Registration, Int[Array, ""]]:
    """The first registration that is believed, or the last one tried, and the number of its attempt.

    One that keypoints no longer share in gives way to the first that they share in. One that few of its
    matches agree with has a rival in the same keyframe, and the one with more inliers is kept.
    """
    params, tracker, _ = inputs
    blank = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(_register_at, inputs, 0))
    # Derivatives are taken at these motions where nothing is tried: no motion has the quaternion 0.
    still = se3.identity(blank.T_target_source.wxyz_xyz.dtype)
    blank = eqx.tree_at(
        lambda f: (f.T_target_source, f.matched.T_target_source, f.matched.T_as_detected), blank, [still] * 3
    )
    first = jnp.where(tracker.num_keyframes > 0, 0, 2 * _BY_LAST)
    count = jnp.where(tracker.has_last, 2 * _BY_LAST, _BY_LAST)
    shared = tracker.has_last & tracker.last_registration.by_keypoints

    def unfinished(state: _Search) -> Bool[Array, ""]:
        found, _, following = state
        doubtful = found.by_keypoints & ~keypoints_are_alike(found.matched, params.config.features)
        missing = ~found.found | (shared & ~found.by_keypoints)
        return (missing & (following < count)) | (doubtful & (following < _BY_LAST))

    def again(state: _Search) -> _Search:
        before, attempt, following = state
        found = _register_at(inputs, following)
        # Of what the attempts say about the scale of depth, the clearest is kept.
        clearer = abs(found.scale_change) * before.scale_sigma >= abs(before.scale_change) * found.scale_sigma
        change = jnp.where(clearer, found.scale_change, before.scale_change)
        sigma = jnp.where(clearer, found.scale_sigma, before.scale_sigma)
        found = eqx.tree_at(lambda f: (f.scale_change, f.scale_sigma), found, (change, sigma))
        more = ~before.by_keypoints | (found.matched.num_inliers > before.matched.num_inliers)
        better = ~before.found | (found.by_keypoints & more)
        kept = jax.tree.map(lambda a, b: jnp.where(better, a, b), (found, following), (before, attempt))
        return *kept, following + 1

    found, attempt, _ = lax.while_loop(unfinished, again, (blank, first, first))
    return found, attempt


@_first_success.def_jvp
def _first_success_jvp(primals: tuple[_Inputs], tangents: tuple) -> tuple:
    """The derivative is that of the attempt that succeeded."""
    (inputs,), (rates,) = primals, tangents
    found, attempt = _first_success(inputs)
    tried = jnp.clip(attempt, 0, 2 * _BY_LAST - 1)
    _, rate = eqx.filter_jvp(lambda moving: _register_at(moving, tried, found), (inputs,), (rates,))
    return (found, attempt), (rate, None)


def _moved(
    tracker: Tracker,
    before: jaxlie.SE3,
    T_reference_cam: jaxlie.SE3,
    source: Int[Array, ""],
    relocalised: Bool[Array, ""] | bool,
) -> Tracker:
    """The tracker with the frame's pose, and the motion model after it."""
    tracked, by_model = source != PoseSource.LOST, source == PoseSource.MOTION_MODEL
    after = eqx.tree_at(lambda t: t.T_reference_cam, tracker, T_reference_cam)
    identity = se3.identity(before.wxyz_xyz.dtype).wxyz_xyz
    measured = se3.compose(se3.inverse(before), after.T_world_cam).wxyz_xyz
    predicted = tracker.predicted_motion
    # A frame that rests on the motion model teaches it nothing. A lost one leaves a guess, which is no longer
    # believed where nothing else confirms it.
    motion = jnp.where(by_model, predicted.wxyz_xyz, measured)
    motion = jnp.where(jnp.asarray(relocalised), identity, motion)
    known = ~jnp.asarray(relocalised) & jnp.where(by_model, tracker.has_motion, tracker.num_keyframes > 0)
    return eqx.tree_at(
        lambda t: (
            t.T_previous_current,
            t.motion_seconds,
            t.since_tracked,
            t.has_motion,
            t.lost_in_a_row,
            t.motion_model_frames,
            t.motion_model_travel,
            t.suspicion.frames,
            t.suspicion.unknown,
        ),
        after,
        (
            jaxlie.SE3(jnp.where(tracked, motion, tracker.T_previous_current.wxyz_xyz)),
            jnp.where(tracked, tracker.since_tracked, tracker.motion_seconds),
            jnp.where(tracked, 0, tracker.since_tracked),
            tracked & known,
            jnp.where(tracked, 0, tracker.lost_in_a_row + 1),
            _counted(tracker.motion_model_frames, 1, by_model, tracked),
            _counted(tracker.motion_model_travel, extent(predicted), by_model, tracked),
            jnp.where(tracked, 0, tracker.suspicion.frames),
            jnp.where(tracked, 0, tracker.suspicion.unknown),
        ),
    )


def _counted(total: Array, more: Array | int, by_model: Bool[Array, ""], tracked: Bool[Array, ""]) -> Array:
    """A count over frames in a row that rest on the motion model; a lost frame leaves it as it is."""
    return jnp.where(by_model, total + more, jnp.where(tracked, 0, total))


def _pushed(tracker: Tracker, new: Reference) -> Tracker:
    """The tracker with the newest frame as a new keyframe, and as its reference."""
    after, count = with_reference(tracker, new), tracker.num_keyframes + 1
    return replace(after, num_keyframes=count, T_reference_cam=se3.identity(new.pose.dtype))


def _with_rows_in_time(
    params: TrackerParams,
    tracker: Tracker,
    new_keyframe: Bool[Array, ""],
    seen: FrameFeatures,
    motion: gicp.RowMotion,
    T_world_cam: jaxlie.SE3,
) -> Tracker:
    """The tracker with its reference, a new keyframe or the one before, rectified by the newest times.

    The next frame's rows are moved by these. In a reference that was rectified by others, its pose would be
    off by the camera's motion in the difference.
    """
    new = Reference(seen, motion, T_world_cam.wxyz_xyz, tracker.num_keyframes)
    if not params.config.estimate_timing:
        return lax.cond(new_keyframe, lambda t: _pushed(t, new), lambda t: t, tracker)
    as_read = replace(motion, timing=jax.tree.map(jnp.zeros_like, motion.timing))
    choose = partial(jax.tree.map, partial(jnp.where, new_keyframe))
    by = choose(as_read, reference_at(tracker, tracker.current).motion)
    timing, _ = estimated_timing(params, tracker)
    change = timing.vector - by.timing.vector
    stale = by.known & jnp.any(abs(change) > _STALE)

    def renewed(tracker: Tracker) -> Tracker:
        read = choose(new, reference_at(tracker, tracker.current))
        kept = rectified(read.features, params.camera, replace(by, timing=SensorTiming.of_vector(change)))
        read = read._replace(features=kept, motion=replace(by, timing=timing))
        # From one step back in the ring, a reference takes its own place.
        count = new_keyframe.astype(tracker.current.dtype)
        after = with_reference(replace(tracker, current=tracker.current + count - 1), read)
        T = choose(se3.identity(change.dtype), tracker.T_reference_cam)
        return replace(after, num_keyframes=tracker.num_keyframes + count, T_reference_cam=T)

    return lax.cond(new_keyframe | stale, renewed, lambda t: t, tracker)


def _remembered(
    tracker: Tracker,
    seen: FrameFeatures,
    motion: gicp.RowMotion,
    found: Registration,
    tracked: Array,
    could_be_keyframe: Array,
) -> Tracker:
    """The tracker with a tracked frame as the last one: the next may need it as a keyframe."""
    last = jax.tree.map(
        lambda new, old: jnp.where(tracked, new, old),
        (seen, motion, found),
        (tracker.last, tracker.last_motion, tracker.last_registration),
    )
    return eqx.tree_at(
        lambda t: (t.last, t.last_motion, t.last_registration, t.has_last),
        tracker,
        (*last, jnp.where(tracked, could_be_keyframe, tracker.has_last)),
    )
