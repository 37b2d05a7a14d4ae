"""Do two images show the same where a motion lays one over the other?

Matched keypoints and surfaces only speak of what they were found at. Among tiles or shelves that look alike,
the images between the matches tell the right one. So coarse images are compared wherever both show the same
surface, block by block. Exposure and blur change little in them, and most blocks have to be alike, so things
that move may differ.
"""

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jax import lax
from jax.lax import Precision
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax import gicp
from sfgs_jax.slam.state._frame_features import FrameFeatures

_WIDTH = 80
"""Least width of the coarse images, pixels."""
_SIGMA = 1 / 80
"""Standard deviation of the Gaussian that they are smoothed by, in their widths."""
_BLOCKS = (6, 8)
"""Rows and columns of blocks."""
_LEAST_FILL = 0.15
"""Least share of a block's pixels that both images show."""
_LEAST_CONTRAST = 0.01
"""Least standard deviation of the grey values in a block, of 1, in each of the images."""
_LEAST_BLOCKS = 16
"""Blocks below which nothing is said: a third of the image. Views that share less say little."""
_OCCLUDED = 0.04
"""Difference of depth, as a share of it, beyond which two pixels show different things."""


def image_correlation(
    source: FrameFeatures, target: FrameFeatures, T_target_source: jaxlie.SE3
) -> Float[Array, ""]:
    """Correlation of two frames' images where a motion lays one over the other, without derivatives.

    Args:
        source: a frame.
        target: another.
        T_target_source: the motion that is in question.

    Returns:
        The median of the blocks' correlations, at most 1. It is 1 where there is too little to compare: no
        images are kept, or few blocks with contrast are seen in both.
    """
    if not source.grey.size:
        return jnp.ones(())
    source, target, T = lax.stop_gradient((source, target, T_target_source))
    correlations, told = _block_correlations(source, target, T)
    count = jnp.sum(told)
    median = jnp.sort(jnp.where(told, correlations, jnp.inf))[(count - 1) // 2]
    return jnp.where(count >= _LEAST_BLOCKS, median, 1)


def _block_correlations(
    source: FrameFeatures, target: FrameFeatures, T: jaxlie.SE3
) -> tuple[Float[Array, " b"], Bool[Array, " b"]]:
    """Correlation of the two images in each block of the source, and whether it can be told."""
    mine, other = _coarse(source.cloud), _coarse(target.cloud)
    (u, v), near = _places(mine, other, T)
    seen = _sampled(_smoothed(target.grey, other.valid.shape), u, v)
    wanted = _smoothed(source.grey, mine.valid.shape)
    shared = near.astype(wanted.dtype)
    # Centred before they are squared.
    wanted, seen = ((x - jnp.mean(x)) * shared for x in (wanted, seen))
    products = jnp.stack([shared, wanted, seen, wanted * wanted, seen * seen, wanted * seen])
    blocks = _blocks(near.shape)
    sums = jnp.matmul(products.reshape(6, -1), jnp.asarray(blocks, wanted.dtype), precision=Precision.HIGHEST)
    a, b, aa, bb, ab = sums[1:] / jnp.maximum(sums[0], 1)[None]
    variances, covariance = (jnp.maximum(aa - a * a, 0), jnp.maximum(bb - b * b, 0)), ab - a * b
    told = (sums[0] >= _LEAST_FILL * blocks.sum(axis=0)) & (jnp.minimum(*variances) > _LEAST_CONTRAST**2)
    square = jnp.where(told, variances[0] * variances[1], 1)
    return covariance / jnp.sqrt(square), told


def _coarse(cloud: gicp.OrganisedCloud) -> gicp.OrganisedLevel:
    """The coarsest level that is wide enough, or the finest."""
    return next((x for x in cloud.levels[::-1] if x.valid.shape[1] >= _WIDTH), cloud.levels[0])


def _places(
    mine: gicp.OrganisedLevel, other: gicp.OrganisedLevel, T: jaxlie.SE3
) -> tuple[Float[Array, "2 h w"], Bool[Array, "h w"]]:
    """Places of a level's pixels in another, and whether both show the same surface there."""
    height, width = other.valid.shape
    points = jnp.moveaxis(mine.points, -1, 0)
    R, t = T.rotation().as_matrix(), T.translation()
    x, y, z = (sum(R[i, j] * points[j] for j in range(3)) + t[i] for i in range(3))
    depth = jnp.maximum(z, 1e-3)
    u, v = other.camera.fx * x / depth + other.camera.cx, other.camera.fy * y / depth + other.camera.cy
    inside = (u >= 0) & (u <= width - 1) & (v >= 0) & (v <= height - 1) & (z > 1e-3) & mine.valid
    u, v = jnp.where(inside, u, 0), jnp.where(inside, v, 0)
    at = (jnp.round(v) * width + jnp.round(u)).astype(jnp.int32)
    there = jnp.where(other.valid, other.points[..., 2], 0).reshape(-1)[at]
    return jnp.stack([u, v]), inside & (jnp.abs(there - z) < _OCCLUDED * z)


def _smoothed(grey: Float[Array, "h w"], shape: tuple[int, ...]) -> Float[Array, "r c"]:
    """A smaller, smooth image on the pixels of a level."""
    sigma = _SIGMA * grey.shape[1]
    rows, columns = (_gaussians(n, m, sigma) for n, m in zip(shape, grey.shape, strict=True))
    rows, columns = jnp.asarray(rows, grey.dtype), jnp.asarray(columns, grey.dtype)
    return jnp.matmul(
        jnp.matmul(rows, grey, precision=Precision.HIGHEST), columns.T, precision=Precision.HIGHEST
    )


def _gaussians(count: int, length: int, sigma: float) -> Float[np.ndarray, "n m"]:
    """Weights of pixels around the middle of each larger pixel; levels drop what fills no whole pixel."""
    halving = 2.0 ** round(np.log2(length / count))
    centres = (np.arange(count)[:, None] + 0.5) * halving - 0.5
    weights = np.exp(-0.5 * ((np.arange(length)[None] - centres) / sigma) ** 2)
    return weights / weights.sum(axis=1, keepdims=True)


def _sampled(
    image: Float[Array, "h w"], u: Float[Array, "r c"], v: Float[Array, "r c"]
) -> Float[Array, "r c"]:
    return jax.scipy.ndimage.map_coordinates(image, [v, u], order=1, mode="nearest")


def _blocks(shape: tuple[int, ...]) -> Int[np.ndarray, "n b"]:
    """1 where a pixel, row by row, belongs to a block."""
    row, column = (np.arange(n) * k // n for n, k in zip(shape, _BLOCKS, strict=True))
    block = (row[:, None] * _BLOCKS[1] + column[None]).reshape(-1)
    return (block[:, None] == np.arange(_BLOCKS[0] * _BLOCKS[1])[None]).astype(int)
