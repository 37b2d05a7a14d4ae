"""What a frame shows: its surface for GICP, and its keypoints with their depth."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from sfgs_jax import gicp
from sfgs_jax.geometry import Camera, Frame, clean_depth
from sfgs_jax.slam.config import FeaturesConfig, TrackingConfig
from sfgs_jax.superfeats import Features, extract, extract_orb, load_weights, mean_grey
from sfgs_jax.superfeats.network import Network


class Keypoints(eqx.Module):
    """Keypoints of a frame with the depth measured there.

    Attributes:
        features: positions and descriptors, K slots.
        depth: (K,) metres along z; 0 where it is missing or differs around the keypoint.
        points: (K, 3) camera coordinates, metres; on the image plane at 1 m where there is no depth.
        signature: (D,) descriptor of the whole image, of unit length; 0 without keypoints.
    """

    features: Features
    depth: Float[Array, " k"]
    points: Float[Array, "k 3"]
    signature: Float[Array, " d"]

    @property
    def measured(self) -> Bool[Array, " k"]:
        """(K,) slots that hold a keypoint with depth."""
        return self.features.valid & (self.depth > 0)


class Observation(eqx.Module):
    """What registration sees of a frame.

    Attributes:
        cloud: its prepared depth image.
        keypoints: its keypoints; no slots at all where features are switched off.
    """

    cloud: gicp.OrganisedCloud
    keypoints: Keypoints


Extractor = Network | None
"""The network's weights, or None where another extractor, or none, is used."""


def load_extractor(config: FeaturesConfig) -> Extractor:
    """What `observe` needs besides the frame."""
    return load_weights() if config.kind == "superfeats" else None


def observe(frame: Frame, camera: Camera, extractor: Extractor, config: TrackingConfig) -> Observation:
    """The observation of a frame.

    Args:
        frame: of its depth, what is not finite or not positive counts as missing.
        camera: intrinsics of the frame.
        extractor: from `load_extractor`.
        config: settings.
    """
    features, grey = config.features, mean_grey(frame.rgb)
    if features.kind == "orb":
        found = extract_orb(np.asarray(frame.rgb), max_keypoints=features.max_keypoints)
        return _with_features(found, grey, frame.depth, camera, config)
    return _observe(extractor, grey, frame.depth, camera, config)


@partial(jax.jit, static_argnames="config")
def _observe(
    extractor: Extractor,
    grey: Float[Array | np.ndarray, "H W"],
    depth: Float[Array | np.ndarray, "H W"],
    camera: Camera,
    config: TrackingConfig,
) -> Observation:
    if extractor is None:
        features = empty_features()
    else:
        features = extract(extractor, grey, max_keypoints=config.features.max_keypoints)
    return _with_features(features, grey, depth, camera, config)


@partial(jax.jit, static_argnames="config")
def _with_features(
    features: Features,
    grey: Float[Array | np.ndarray, "H W"],
    depth: Float[Array | np.ndarray, "H W"],
    camera: Camera,
    config: TrackingConfig,
) -> Observation:
    depth, _ = clean_depth(jnp.asarray(depth))
    features = _with_contrast(features, jnp.asarray(grey), config.features.min_contrast)
    at = _depth_at(depth, features.keypoints, config.features.depth_tolerance)
    points = camera.unproject(features.keypoints, jnp.where(at > 0, at, 1))
    return Observation(
        gicp.prepare(depth, camera, config=config.gicp), Keypoints(features, at, points, signature(features))
    )


_SIGNATURE_SIZE = 64


def signature(features: Features) -> Float[Array, " d"]:
    """Descriptor of a whole image: the second moments of its keypoints' descriptors.

    Their signed square roots keep frequent structures from drowning rare ones. Two images' signatures are
    compared by their dot product, at most 1. Source: Carreira et al., Semantic segmentation with
    second-order pooling (ECCV 2012), with the power normalisation used for image retrieval.
    """
    part = jnp.where(features.valid[:, None], features.descriptors, 0)[:, :_SIGNATURE_SIZE]
    count = jnp.maximum(jnp.sum(features.valid.astype(part.dtype)), 1)
    moments = (part.T @ part / count).reshape(-1)
    rooted = jnp.sign(moments) * jnp.sqrt(jnp.maximum(jnp.abs(moments), 1e-12))
    return jnp.where(jnp.any(features.valid), rooted / jnp.linalg.norm(rooted), 0)


_BLOCK = 4
"""Pixels along the side of the blocks that contrast is judged by: their means have little noise."""


def _with_contrast(features: Features, grey: Float[Array, "H W"], least: float) -> Features:
    """The features without those around which the image shows nothing.

    Judged by the block of pixels that a keypoint lies in and the four beside it, no farther: beside the
    outline of a bare thing an extractor finds artefacts on the thing, which move with the outline.
    """
    height, width = grey.shape
    rows, columns = height // _BLOCK, width // _BLOCK
    # Rows are added up before columns: along these the sums run as vectors.
    strips = grey[: rows * _BLOCK, : columns * _BLOCK].reshape(rows, _BLOCK, -1).sum(axis=1)
    means = strips.reshape(rows, columns, _BLOCK).sum(axis=-1) / _BLOCK**2
    padded = jnp.pad(means, 1, mode="edge")
    # Shading that changes evenly is no contrast, however steep.
    bends = jnp.maximum(
        jnp.abs(padded[:-2, 1:-1] + padded[2:, 1:-1] - 2 * means),
        jnp.abs(padded[1:-1, :-2] + padded[1:-1, 2:] - 2 * means),
    )
    column, row = (features.keypoints / _BLOCK).astype(jnp.int32).T
    contrast = bends[jnp.clip(row, 0, rows - 1), jnp.clip(column, 0, columns - 1)]
    valid = features.valid & (contrast >= least)
    return Features(features.keypoints, features.scores, features.descriptors, valid)


def empty_features() -> Features:
    """No slots."""
    return Features(jnp.zeros((0, 2)), jnp.zeros(0), jnp.zeros((0, 64)), jnp.zeros(0, bool))


def _depth_at(
    depth: Float[Array, "H W"], pixels: Float[Array, "k 2"], tolerance: float
) -> Float[Array, " k"]:
    """Depth at the nearest pixel, 0 where the 9 x 9 around it holds an edge.

    Corners often lie on the outlines of things, where a pixel's depth is that of one side or the other, and
    the outline of a round thing does not even stay where it is. Across a plane, 1 / depth is linear, however
    steep the plane: an edge is where the mean of two opposite pixels differs from the one between them.
    """
    height, width = depth.shape
    steps = jnp.arange(-4, 5, 2)
    u, v = jnp.round(jax.lax.stop_gradient(pixels)).astype(jnp.int32).T
    rows = jnp.clip(v[:, None, None] + steps[:, None], 0, height - 1)
    columns = jnp.clip(u[:, None, None] + steps, 0, width - 1)
    around = depth[rows, columns].reshape(-1, 25)
    centre = around[:, 12]
    relative = centre[:, None] / jnp.where(around > 0, around, jnp.inf)
    bend = jnp.abs((relative + relative[:, ::-1]) / 2 - 1)
    both = (around > 0) & (around[:, ::-1] > 0)
    return jnp.where((centre > 0) & jnp.all(~both | (bend < tolerance), axis=1), centre, 0)


def blank_observation(camera: Camera, config: TrackingConfig) -> Observation:
    """An observation of this structure, without arrays: what saved ones are read into."""
    depth = jax.ShapeDtypeStruct(camera.shape, jnp.float32)
    return jax.eval_shape(lambda d, c: _with_features(empty_features(), d, d, c, config), depth, camera)
