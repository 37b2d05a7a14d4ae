"""Features of a frame: extraction, keypoint depth, and the depth pyramid."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sfgs_jax import gicp
from sfgs_jax.arrays import InputError, checked
from sfgs_jax.geometry import Camera, Frame, clean_depth
from sfgs_jax.sensors import DEPTH_GRID, DepthCorrection, SensorModel, SensorTiming
from sfgs_jax.slam.config import TrackingConfig
from sfgs_jax.slam.frontend._depth_scatter import is_noise
from sfgs_jax.slam.frontend._image_signature import image_signature
from sfgs_jax.slam.frontend._patch_alignment import patch_factor
from sfgs_jax.slam.state._depth_information import prior_of
from sfgs_jax.slam.state._frame_features import FrameFeatures, Keypoints
from sfgs_jax.slam.state._tracker import TrackerParams, TrackingNoise
from sfgs_jax.superfeats import Features, extract, extract_orb, load_weights, mean_grey

_BLOCK = 4
"""Side of the blocks of pixels that contrast is measured between. Their means have little noise."""


@checked
def tracker_params(
    camera: Camera, config: TrackingConfig, sensors: SensorModel | None = None
) -> TrackerParams:
    """Parameters of tracking with the shipped keypoint network.

    Args:
        camera: intrinsics of the frames.
        config: settings.
        sensors: what is known about the camera before the first frame. Rows whose times are not known count
            as exposed at once, and depth as right.

    Raises:
        InputError: times or a correction of depth are given that the settings leave without effect.
    """
    sensors = sensors or SensorModel()
    if sensors.timing is not None and not config.estimate_timing:
        raise InputError(
            "Times of the rows have no effect without estimate_timing: turn it on, or give none."
        )
    if sensors.depth is not None and not config.estimate_depth:
        raise InputError(
            "A correction of depth has no effect without estimate_depth: turn it on, or give none."
        )
    network = load_weights() if config.features.kind == "superfeats" else None
    correction = sensors.depth or DepthCorrection(jnp.zeros(DEPTH_GRID))
    if config.estimate_extrinsic and correction.extrinsic is None:
        correction = DepthCorrection(correction.offsets, jnp.zeros(6, correction.offsets.dtype))
    correction = correction if config.estimate_depth else None
    timing = sensors.timing or SensorTiming()
    root = prior_of(config).root if config.estimate_depth else np.zeros((0, 0))
    depth_root = jnp.asarray(root, jnp.float32)
    return TrackerParams(camera, network, timing, correction, depth_root, _noise(config), config)


def _noise(config: TrackingConfig) -> TrackingNoise:
    features = config.features
    detected, pixels, inverse_depth, metres, per_square_metre = (
        jnp.asarray(x, jnp.float32)
        for x in (
            *(features.pixel_sigma, features.matched_sigma, features.inverse_depth_sigma),
            *(config.gicp.noise, config.gicp.noise_per_square_metre),
        )
    )
    return TrackingNoise(detected, pixels, inverse_depth, gicp.DistanceNoise(metres, per_square_metre))


@checked
def observe(params: TrackerParams, frame: Frame) -> FrameFeatures:
    """Features of a frame, by one compiled program.

    Args:
        params: parameters of tracking.
        frame: colour image and depth; depth that is not finite or not positive counts as missing.
    """
    return _observe(params, mean_grey(frame.rgb), frame.depth, host_keypoints(params, frame))


def host_keypoints(params: TrackerParams, frame: Frame) -> Features | None:
    """Keypoints of an extractor that runs on the host, ORB; None where the network runs in `track`.

    Args:
        params: parameters of tracking.
        frame: colour image and depth.
    """
    features = params.config.features
    if features.kind != "orb":
        return None
    return extract_orb(np.asarray(frame.rgb), max_keypoints=features.max_keypoints)


@jax.jit
def _observe(
    params: TrackerParams, grey: Array | np.ndarray, depth: Array | np.ndarray, features: Features | None
) -> FrameFeatures:
    return frame_features(params, jnp.asarray(grey), jnp.asarray(depth), features)


def frame_features(
    params: TrackerParams,
    image: Float[Array, "H W"] | Float[Array, "H W 3"],
    depth: Float[Array, "H W"],
    features: Features | None = None,
) -> FrameFeatures:
    """Features of a frame; differentiable.

    Args:
        params: parameters of tracking.
        image: grey values or colours in [0, 1].
        depth: metres along z; not finite or not positive counts as missing.
        features: keypoints found before, instead of those of the network.
    """
    config, grey = params.config, jnp.asarray(mean_grey(image) if image.ndim == 3 else image)
    if features is None:
        network, slots = params.network, config.features.max_keypoints
        features = empty_features() if network is None else extract(network, grey, max_keypoints=slots)
    depth, _ = clean_depth(depth)
    depth = jnp.where(is_noise(depth, config.max_depth_scatter), 0, depth)
    if params.depth_correction is not None:
        depth = params.depth_correction.corrected(depth, params.camera)
    features = _with_contrast(features, grey, config.features.min_contrast)
    at = _depth_at(depth, features.keypoints, config.features.depth_tolerance)
    points = params.camera.unproject(features.keypoints, jnp.where(at > 0, at, 1))
    cloud = gicp.prepare(depth, params.camera, config=config.gicp)
    normals = _normals_at(cloud.levels[0], points)
    signature = image_signature(features)
    keypoints = Keypoints(features, at, points, normals, signature, features.keypoints)
    with_patches = config.features.align_patches and len(at)
    factor, none = patch_factor(params.camera.width), jnp.zeros((0, 0), grey.dtype)
    return FrameFeatures(cloud, keypoints, _block_means(grey, factor) if with_patches else none)


def with_corrected_depth(params: TrackerParams, frame: Frame) -> Frame:
    """A frame whose depth has the correction in use.

    Args:
        params: parameters of tracking.
        frame: as it was read.
    """
    if params.depth_correction is None:
        return frame
    return replace(frame, depth=_corrected(params.depth_correction, jnp.asarray(frame.depth), params.camera))


@jax.jit
def _corrected(
    correction: DepthCorrection, depth: Float[Array, "H W"], camera: Camera
) -> Float[Array, "H W"]:
    return correction.corrected(depth, camera)


def empty_features() -> Features:
    """No keypoints and no slots."""
    return Features(jnp.zeros((0, 2)), jnp.zeros(0), jnp.zeros((0, 64)), jnp.zeros(0, bool))


def feature_shapes(params: TrackerParams) -> FrameFeatures:
    """Shapes of a frame's features, without arrays.

    Args:
        params: parameters of tracking.
    """
    image = jax.ShapeDtypeStruct(params.camera.shape, jnp.float32)
    slots = params.config.features.max_keypoints if params.config.features.kind == "orb" else None
    found = None if slots is None else jax.eval_shape(partial(_blank_orb, slots))
    return jax.eval_shape(frame_features, params, image, image, found)


def _blank_orb(slots: int) -> Features:
    return Features(jnp.zeros((slots, 2)), jnp.zeros(slots), jnp.zeros((slots, 256)), jnp.zeros(slots, bool))


def _with_contrast(features: Features, grey: Float[Array, "H W"], least: float) -> Features:
    """Features around which the image has contrast, by second differences between blocks of pixels.

    The test reaches no farther than the four blocks beside a keypoint's own. Beside the outline of a bare
    surface a detector finds artefacts, which move with the outline.
    """
    means = _block_means(grey, _BLOCK)
    rows, columns = means.shape
    padded = jnp.pad(means, 1, mode="edge")
    # Even shading is no contrast, however steep.
    bends = jnp.maximum(
        jnp.abs(padded[:-2, 1:-1] + padded[2:, 1:-1] - 2 * means),
        jnp.abs(padded[1:-1, :-2] + padded[1:-1, 2:] - 2 * means),
    )
    column, row = (features.keypoints / _BLOCK).astype(jnp.int32).T
    contrast = bends[jnp.clip(row, 0, rows - 1), jnp.clip(column, 0, columns - 1)]
    valid = features.valid & (contrast >= least)
    return Features(features.keypoints, features.scores, features.descriptors, valid)


def _block_means(grey: Float[Array, "H W"], side: int) -> Float[Array, "h w"]:
    height, width = grey.shape
    rows, columns = height // side, width // side
    # Rows are added up before columns, because sums along columns are vectorised.
    strips = grey[: rows * side, : columns * side].reshape(rows, side, -1).sum(axis=1)
    return strips.reshape(rows, columns, side).sum(axis=-1) / side**2


def _normals_at(level: gicp.OrganisedLevel, points: Float[Array, "k 3"]) -> Float[Array, "k 3"]:
    """Normals of the surface at the pixels of some points, 0 where there is none."""
    height, width = level.valid.shape
    u, v = jnp.round(level.camera.project(jax.lax.stop_gradient(points))).astype(jnp.int32).T
    row, column = jnp.clip(v, 0, height - 1), jnp.clip(u, 0, width - 1)
    return jnp.where(level.valid[row, column][:, None], level.normals[row, column], 0)


def _depth_at(
    depth: Float[Array, "H W"], pixels: Float[Array, "k 2"], tolerance: float
) -> Float[Array, " k"]:
    """Depth at the nearest pixel, 0 where the 9 x 9 around it holds a depth edge.

    Corners often lie on outlines, where a pixel's depth belongs to one side or the other. The outline of a
    round object even moves with the camera. Inverse depth is linear across a plane, however steep. So an edge
    is where the mean of two opposite pixels differs from the pixel between them.
    """
    height, width = depth.shape
    steps = jnp.arange(-4, 5, 2)
    u, v = jnp.round(jax.lax.stop_gradient(pixels)).astype(jnp.int32).T
    rows = jnp.clip(v[:, None, None] + steps[None, :, None], 0, height - 1)
    columns = jnp.clip(u[:, None, None] + steps[None, None], 0, width - 1)
    around = depth[rows, columns].reshape(-1, 25)
    centre = around[:, 12]
    relative = centre[:, None] / jnp.where(around > 0, around, jnp.inf)
    bend = jnp.abs((relative + relative[:, ::-1]) / 2 - 1)
    both = (around > 0) & (around[:, ::-1] > 0)
    return jnp.where((centre > 0) & jnp.all(~both | (bend < tolerance), axis=1), centre, 0)
