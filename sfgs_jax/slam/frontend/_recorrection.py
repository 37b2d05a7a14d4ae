"""Features of a frame after the estimate of its depth's errors has changed."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sfgs_jax import gicp
from sfgs_jax.arrays import dot
from sfgs_jax.geometry import Camera
from sfgs_jax.sensors import DepthCorrection, carried, corrected_depth, depth_slopes, turned
from sfgs_jax.slam.frontend._rectification import on_pixels, origins
from sfgs_jax.slam.state._frame_features import FrameFeatures, Keypoints
from sfgs_jax.slam.state._keyframe_graph import Keyframe, KeyframeGraph
from sfgs_jax.slam.state._tracker import Reference, Tracker, TrackerParams


def depth_parameters_in_use(params: TrackerParams) -> Float[np.ndarray, " G"]:
    """Parameters of the depth correction of new frames; none if depth is not corrected.

    Args:
        params: parameters of tracking.
    """
    correction = params.depth_correction
    return np.zeros(0) if correction is None else correction.on_host().astype(np.float64)


def params_of(params: TrackerParams, keyframe: Keyframe) -> TrackerParams:
    """Parameters with the correction of depth that a keyframe's features have.

    Args:
        params: parameters of tracking.
        keyframe: with the correction of its time.
    """
    if params.depth_correction is None or not _change(params, keyframe).any():
        return params
    return replace(params, depth_correction=_grid(params, keyframe.depth_parameters))


def features_in_use(params: TrackerParams, keyframe: Keyframe) -> FrameFeatures:
    """Features of a keyframe with the correction of new frames.

    Args:
        params: parameters of tracking.
        keyframe: with the correction of its time.
    """
    change = _change(params, keyframe)
    return (
        recorrected(keyframe.features, params.camera, _grid(params, change))
        if change.any()
        else keyframe.features
    )


def as_reference(params: TrackerParams, graph: KeyframeGraph, number: int) -> Reference:
    """A keyframe for new frames to be registered to, with their correction of depth.

    Args:
        params: parameters of tracking.
        graph: that holds it.
        number: of the keyframe.
    """
    keyframe = graph.keyframes[number]
    features = features_in_use(params, keyframe)
    return Reference(features, keyframe.motion, graph.poses[number], np.asarray(number, np.int32))


def _change(params: TrackerParams, keyframe: Keyframe) -> Float[np.ndarray, " G"]:
    """Parameters of the correction of new frames, less those of a keyframe's features."""
    return depth_parameters_in_use(params) - keyframe.depth_parameters


def with_depth_parameters(
    params: TrackerParams,
    tracker: Tracker,
    parameters: Float[np.ndarray, " G"],
    covariance: Float[np.ndarray, "G G"],
) -> tuple[TrackerParams, Tracker]:
    """Parameters and tracker with another correction of depth, for the frames to come and those held.

    Args:
        params: parameters of tracking.
        tracker: whose features have their correction.
        parameters: parameters of the new correction.
        covariance: of these.
    """
    change = parameters - depth_parameters_in_use(params)
    references, last = _recorrected_tracker(tracker, params.camera, _grid(params, change))
    root = np.linalg.cholesky(covariance).astype(params.depth_root.dtype)
    timing = tracker.timing.counted_from(np.concatenate([np.zeros(3), change]))
    return (
        replace(params, depth_correction=_grid(params, parameters), depth_root=jax.device_put(root)),
        replace(tracker, references=references, last=last, timing=timing),
    )


@jax.jit
def _recorrected_tracker(
    tracker: Tracker, camera: Camera, change: DepthCorrection
) -> tuple[FrameFeatures, FrameFeatures]:
    references = jax.vmap(recorrected, in_axes=(0, None, None))(tracker.references, camera, change)
    return references, recorrected(tracker.last, camera, change)


def _grid(params: TrackerParams, parameters: Float[np.ndarray, " G"]) -> DepthCorrection:
    assert params.depth_correction is not None
    like = params.depth_correction
    return _with_vector(like, parameters.astype(like.offsets.dtype))


@jax.jit
def _with_vector(like: DepthCorrection, parameters: Float[Array, " G"]) -> DepthCorrection:
    return like.with_vector(parameters)


@jax.jit
def recorrected(features: FrameFeatures, camera: Camera, change: DepthCorrection) -> FrameFeatures:
    """Features as they would be with another correction of depth.

    Points move along their rays. The normals turn with the planes: a plane stays one while the offsets vary
    linearly, and its inverse depth loses theirs. Then all of the surface moves with the depth camera.

    Args:
        features: of a frame, with the correction before.
        camera: intrinsics.
        change: correction now minus correction before.
    """
    cloud = gicp.OrganisedCloud(tuple(_recorrected_level(level, change) for level in features.cloud.levels))
    return FrameFeatures(cloud, _recorrected_keypoints(features.keypoints, camera, change), features.grey)


def _recorrected_level(level: gicp.OrganisedLevel, change: DepthCorrection) -> gicp.OrganisedLevel:
    camera, offsets = level.camera, change.image(level.camera)
    columns, offset = level.surface.reshape(-1, 6).T, offsets.reshape(-1)
    points, normals, valid = columns[:3], columns[3:], level.valid.reshape(-1)
    down, across = jnp.gradient(offsets)
    slope = camera.fx * across.reshape(-1), camera.fy * down.reshape(-1)
    depth = jnp.where(valid, points[2], 1)
    # Offsets as a linear function of the ray (x / z, y / z, 1).
    constant = offset - (slope[0] * points[0] + slope[1] * points[1]) / depth
    linear = jnp.stack([*slope, constant])
    # A plane n p = d has the inverse depth (n / d) (x / z, y / z, 1); normals face the camera, so d < 0.
    towards = normals - dot(normals, points)[None] * linear
    length = jnp.sqrt(dot(towards, towards))
    known = corrected_depth(depth, offset)
    valid &= (known > 0) & (length > 0)
    points, normals = points * (known / depth)[None], towards / jnp.where(valid, length, 1)[None]
    if change.extrinsic is None:
        surface = jnp.where(valid[None], jnp.concatenate([points, normals]), 0).T.reshape(level.surface.shape)
        return replace(level, surface=surface, valid=valid.reshape(level.valid.shape))
    # As far as the extrinsic's tangent goes in a unit of time.
    motion, once = change.extrinsic, jnp.ones_like(depth)
    rays = camera.unproject(camera.pixels().reshape(-1, 2), once).T
    moved = carried(jnp.where(valid[None], points, rays), motion, once)
    index, inside = origins(camera, moved)
    # A row is read in one piece.
    surface = jnp.concatenate([moved, turned(normals, motion, once)]).T[index].T
    return on_pixels(level, surface[:3], surface[3:], valid[index] & inside)


def _recorrected_keypoints(keypoints: Keypoints, camera: Camera, change: DepthCorrection) -> Keypoints:
    pixels = keypoints.features.keypoints
    depth = corrected_depth(keypoints.depth, change.at(pixels, camera))
    if change.extrinsic is not None:
        slopes = depth_slopes(keypoints.points.T, keypoints.normals.T)
        depth = depth * (1 + jnp.sum(change.extrinsic[:, None] * slopes, axis=0))
    points = camera.unproject(pixels, jnp.where(depth > 0, depth, 1))
    return replace(keypoints, depth=depth, points=points)
