"""Pose of a frame, and what to do when it is not found."""

from typing import NamedTuple

import jax.numpy as jnp
import jaxlie
import numpy as np

from sfgs_jax.geometry import se3
from sfgs_jax.slam.config import SlamConfig
from sfgs_jax.slam.observation import Observation
from sfgs_jax.slam.registration import Carrier, Registration, register
from sfgs_jax.slam.state import SlamState


class Tracking(NamedTuple):
    """What tracking a frame gave.

    Attributes:
        reference: number of the keyframe that it was registered to.
        found: the registration; its motion means nothing where the carrier is `NONE`. None for a first frame,
            which is registered to nothing.
        carrier: what the pose rests on.
        relocalised: whether the frame was found again after it had been lost.
    """

    reference: int
    found: Registration | None
    carrier: Carrier
    relocalised: bool


def track(state: SlamState, observation: Observation) -> Tracking:
    """Find a frame's pose in the reference: from the motion model, then without it.

    Args:
        state: the run so far, with at least one keyframe.
        observation: of the frame.
    """
    config = state.config.tracking
    reference = state.keyframes[state.reference].observation
    starts = (se3.compose(state.T_reference_cam, state.T_previous_current), state.T_reference_cam)
    found = register(observation, reference, starts[0], state.camera, config)
    carrier = _believed(found, state)
    if carrier == Carrier.NONE:
        found = register(observation, reference, starts[1], state.camera, config)
        carrier = _believed(found, state)
    return Tracking(state.reference, found, carrier, False)


def has_left(found: Registration, config: SlamConfig) -> bool:
    """Whether the camera has moved so far from the reference that the frame should be a keyframe."""
    tracking = config.tracking
    moved = np.asarray(se3.log(found.T_target_source))
    return bool(
        (tracking.use_surface and float(found.inlier_fraction) < tracking.keyframe_inlier_fraction)
        or np.linalg.norm(moved[:3]) > tracking.keyframe_translation
        or np.linalg.norm(moved[3:]) > tracking.keyframe_rotation
    )


def _believed(found: Registration, state: SlamState) -> Carrier:
    """The carrier, unless the motion model has had a part for too long or too far, or is too old for it."""
    carrier, config = Carrier(int(found.carrier)), state.config.tracking
    too_long = state.num_coasting >= config.max_coasting or state.coasted > config.max_coasted
    # A frame that was lost may have moved any way.
    coasting = carrier == Carrier.COASTING and (too_long or _num_lost(state) > 0)
    surface = carrier == Carrier.SURFACE and _long_lost(state)
    return Carrier.NONE if coasting or surface else carrier


def _num_lost(state: SlamState) -> int:
    """How many frames before this one were lost in a row."""
    return state.num_frames - 2 - state.log.newest


def _long_lost(state: SlamState) -> bool:
    """Whether nothing but keypoints can tell any more where the camera is."""
    config = state.config.tracking
    return _num_lost(state) > config.max_lost and config.features.kind != "none"


def relocalise(state: SlamState, observation: Observation) -> Tracking | None:
    """Look for a lost frame in the keyframes that look most like it."""
    graph = state.config.graph
    if not np.asarray(observation.keypoints.features.valid).any():
        return None
    alike = similarities(state, observation)
    order = [int(i) for i in np.argsort(-alike, kind="stable")[: graph.relocalisation_candidates]]
    for number in order:
        keyframe = state.keyframes[number]
        found = register(
            observation, keyframe.observation, se3.identity(), state.camera, state.config.tracking
        )
        carrier = Carrier(int(found.carrier))
        # The surface alone fits many places, so it has to be borne out by matches.
        enough = int(found.matched.num_inliers) >= graph.relocalisation_inliers
        if carrier in (Carrier.BOTH, Carrier.KEYPOINTS) and enough:
            return Tracking(number, found, carrier, True)
    return None


def search(state: SlamState, observation: Observation) -> Tracking | None:
    """Look for a frame by its surface where the camera was last, had it turned.

    What no keypoints match is found only from a start near it: these are what the motion model lacks.
    """
    config = state.config.tracking
    if _long_lost(state) or not config.use_surface:
        return None
    reference = state.keyframes[state.reference].observation
    for turn in config.search_angle * _TURNS:
        start = se3.compose(state.T_reference_cam, se3.exp(turn))
        found = register(observation, reference, start, state.camera, config)
        carrier = _believed(found, state)
        # Nothing speaks for the guess where the surface leaves a direction free.
        if carrier not in (Carrier.NONE, Carrier.COASTING):
            return Tracking(state.reference, found, carrier, False)
    return None


_TURNS = np.concatenate([np.eye(6)[3:5], -np.eye(6)[3:5]]).astype(np.float32)
"""Tangents of turns about the camera's x and y axes, both ways."""


def similarities(state: SlamState, observation: Observation) -> np.ndarray:
    """(n,) how alike each keyframe's image is to this one, at most 1."""
    signatures = np.stack([np.asarray(k.observation.keypoints.signature) for k in state.keyframes])
    return signatures @ np.asarray(observation.keypoints.signature)


def motion_since(state: SlamState, reference: int, T_reference_cam: jaxlie.SE3) -> jaxlie.SE3:
    """`T_previous_current` of a frame newly found in a keyframe."""
    T_world_cam = se3.compose(state.keyframes[reference].T_world_cam, T_reference_cam)
    motion = se3.compose(se3.inverse(state.T_world_cam), T_world_cam)
    return jaxlie.SE3(jnp.asarray(motion.wxyz_xyz))
