"""Losses of SuperFeats' training, each over one pair of images or one image.

Sources: SFGS-SLAM (Wang and Deng, 2025), section 3.1, for `heat_loss`, `contrastive_keypoint_loss` and
`hinge_descriptor_loss`; ALIKE (Zhao et al., 2022) for `reprojection_loss`; LoFTR (Sun et al., 2021) and XFeat
(Potje et al., 2024) for `dual_softmax_loss`. `imitation_loss` and `reliability_loss` take a teacher's outputs
for labels.

Products of coordinates and of descriptors run in float32 on every device.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sfgs_jax.arrays import checked
from sfgs_jax.superfeats._descriptors import cosines, unit
from sfgs_jax.superfeats.detection import MIN_HEAT, heat_map, hottest_near, local_maxima, refine, strongest
from sfgs_jax.superfeats.network import CELL

_TINY = 1e-6
"""Added under roots and logarithms, so that their gradients stay finite."""


@checked
def heat_loss(
    logits: Float[Array, "h w 65"], labels: Float[Array, "h w 65"], weights: Float[Array, "h w"]
) -> Float[Array, ""]:
    """Binary cross-entropy of a heat map against labels, summed over a cell, mean over cells.

    L_BCE = -[q log p + (1 - q) log(1 - p)] with p the softmax of a cell's 64 places and its dustbin.

    Args:
        logits: of the places of each cell and its dustbin.
        labels: q, in [0, 1].
        weights: of the cells; 0 leaves one out.
    """
    log_p = jax.nn.log_softmax(logits)
    log_not_p = jnp.log1p(-jnp.minimum(jnp.exp(log_p), 1 - _TINY))
    entropy = -(labels * log_p + (1 - labels) * log_not_p).sum(-1)
    return _weighted_mean(entropy, weights)


@checked
def keypoint_positions(logits: Float[Array, "h w 65"]) -> Float[Array, "h w 2"]:
    """Soft argmax: the expected pixel (u, v) of each cell's keypoint, given that it has one."""
    h, w, _ = logits.shape
    p = jax.nn.softmax(logits[..., :-1]).reshape(h, w, CELL, CELL)
    steps = jnp.arange(CELL, dtype=logits.dtype)[None, None]
    u = (p.sum(2) * steps).sum(-1) + CELL * jnp.arange(w, dtype=logits.dtype)[None]
    v = (p.sum(3) * steps).sum(-1) + CELL * jnp.arange(h, dtype=logits.dtype)[:, None]
    return jnp.stack([u, v], -1)


@checked
def contrastive_keypoint_loss(
    positions: Float[Array, "n 2"],
    counterparts: Float[Array, "n 2"],
    same: Bool[Array, " n"],
    weights: Float[Array, " n"],
    *,
    margin: float = 1.0,
) -> Float[Array, ""]:
    """Contrastive loss L_con = y d² + (1 - y) max(0, margin - d)², d the distance of two keypoints in cells.

    Args:
        positions: (N, 2) keypoints found in the second image, pixels.
        counterparts: (N, 2) keypoints of the first image, carried to the second, pixels.
        same: (N,) whether the two are the same point (y).
        weights: (N,) of the pairs; 0 leaves one out.
        margin: m_con, cells.
    """
    squared = jnp.square((positions - counterparts) / CELL).sum(-1)
    d = jnp.sqrt(squared + _TINY)
    loss = jnp.where(same, squared, jnp.square(jnp.maximum(margin - d, 0)))
    return _weighted_mean(loss, weights)


@checked
def reprojection_loss(
    logits_a: Float[Array, "h w 65"],
    logits_b: Float[Array, "h w 65"],
    H_b_a: Float[Array, "3 3"],
    hidden_a: Bool[Array, "v u"],
    hidden_b: Bool[Array, "v u"],
    *,
    count: int = 384,
    reach: int = 3,
    ceiling: float = 4.0,
) -> Float[Array, ""]:
    """Mean distance, in pixels, from the first image's keypoints, carried over, to the second image's.

    Keypoints are found and refined by the functions that `extract` uses. In the first image they are the
    strongest, in the second the hottest pixels near the carried ones. The outermost cells are left out.

    Args:
        logits_a: of the first image's cells, whose keypoints are carried over.
        logits_b: of the second image's cells.
        H_b_a: (3, 3) takes pixels (u, v) of the first image to the second's.
        hidden_a: pixels of the first image that do not show the plane of the homography.
        hidden_b: pixels of the second image that do not show it.
        count: keypoints of the first image.
        reach: largest distance along u and v at which a keypoint is looked for, pixels.
        ceiling: largest distance that counts, pixels. A keypoint that isn't found again has no pull.
    """
    heat_a, heat_b = (heat_map(jnp.moveaxis(logits, -1, 0)) for logits in (logits_a, logits_b))
    height, width = hidden_a.shape
    inner = jnp.zeros(heat_a.shape[2:], bool).at[1:-1, 1:-1].set(True)
    scores = jnp.where(local_maxima(heat_a) & (heat_a > MIN_HEAT) & inner[None, None], heat_a, 0.0)
    found, pixels = strongest(jax.lax.stop_gradient(scores), count=count)
    homogeneous = jnp.column_stack([refine(heat_a, pixels), jnp.ones(count)])
    # TF32 would move a pixel at the far border of a 320-pixel view by a sixth of a pixel.
    carried = jnp.matmul(homogeneous, H_b_a.T, precision=jax.lax.Precision.HIGHEST)
    carried = carried[:, :2] / carried[:, 2:]

    nearest = jnp.rint(jax.lax.stop_gradient(carried))
    last = jnp.array([[width, height]], heat_a.dtype) - CELL - 1
    used = (found > 0) & ((nearest >= CELL) & (nearest <= last)).all(1)
    nearest = jnp.clip(nearest, CELL, last)
    for hidden, (u, v) in ((hidden_a, pixels.astype(int).T), (hidden_b, nearest.astype(int).T)):
        used &= ~hidden[v, u]
    there = refine(heat_b, hottest_near(heat_b, nearest, reach=reach))
    distance = jnp.sqrt(jnp.square(there - carried).sum(1) + _TINY)
    return _weighted_mean(jnp.minimum(distance, ceiling), used.astype(distance.dtype))


@checked
def hinge_descriptor_loss(
    a: Float[Array, "n d"],
    b: Float[Array, "n d"],
    positions_a_in_b: Float[Array, "n 2"],
    positions_b: Float[Array, "n 2"],
    valid: Bool[Array, " n"],
    *,
    positive_weight: float = 1.3,
    positive_radius: float = 7.5,
    positive_margin: float = 1.0,
    negative_margin: float = 0.2,
) -> Float[Array, ""]:
    """Hinge loss L_desc of the paper over all pairs of n descriptors of unit length.

    Let s be a pair's dot product. It costs λ_d max(0, m_pos - s) if the points lie near each other, and
    max(0, s - m_neg) otherwise. Each kind is averaged by itself.

    Args:
        a: (N, D) descriptors of the first image's points.
        b: (N, D) descriptors of the second image's points.
        positions_a_in_b: (N, 2) the first image's points in the second image, pixels.
        positions_b: (N, 2) the second image's points, pixels.
        valid: (N,) which points count.
        positive_weight: λ_d.
        positive_radius: σ, largest distance of a positive pair, pixels.
        positive_margin: m_pos.
        negative_margin: m_neg.
    """
    distance = jnp.square(positions_a_in_b[:, None] - positions_b[None]).sum(-1)
    both = (valid[:, None] & valid[None]).astype(a.dtype)
    positive = jnp.where(distance < positive_radius**2, both, 0.0)
    similarity = cosines(a, b)
    pull = _weighted_mean(jnp.maximum(positive_margin - similarity, 0), positive)
    push = _weighted_mean(jnp.maximum(similarity - negative_margin, 0), both - positive)
    return positive_weight * pull + push


@checked
def dual_softmax_loss(
    a: Float[Array, "n d"], b: Float[Array, "n d"], valid: Bool[Array, " n"], *, temperature: float = 0.1
) -> Float[Array, ""]:
    """Dual softmax loss: negative log probability of matching a_i with b_i, in both directions.

    Args:
        a: (N, D) descriptors of the first image's points, of unit length.
        b: (N, D) descriptors of the same points in the second image.
        valid: (N,) which points count.
        temperature: divides the cosines before the softmax.
    """
    logits = cosines(a, b) / temperature
    absent = jnp.asarray(-1e4, logits.dtype)
    forward = jnp.diagonal(jax.nn.log_softmax(jnp.where(valid[None], logits, absent), axis=1))
    backward = jnp.diagonal(jax.nn.log_softmax(jnp.where(valid[:, None], logits, absent), axis=0))
    return -_weighted_mean(forward + backward, valid.astype(a.dtype))


@checked
def imitation_loss(
    descriptors: Float[Array, "h w d"], labels: Float[Array, "h w d"], weights: Float[Array, "h w"]
) -> Float[Array, ""]:
    """One minus the cosine between descriptors and a teacher's.

    Args:
        descriptors: of the cells, of any length.
        labels: the teacher's, of any length.
        weights: of the cells; 0 leaves one out.
    """
    return _weighted_mean(1 - (unit(descriptors) * unit(labels)).sum(-1), weights)


@checked
def reliability_loss(
    logits: Float[Array, "h w"], labels: Float[Array, "h w"], weights: Float[Array, "h w"]
) -> Float[Array, ""]:
    """Binary cross-entropy of reliability against labels.

    Args:
        logits: of the cells.
        labels: in [0, 1].
        weights: of the cells; 0 leaves one out.
    """
    entropy = jnp.logaddexp(logits, 0.0) - labels * logits
    return _weighted_mean(entropy, weights)


def _weighted_mean(x: Float[Array, "..."], weights: Float[Array, "..."]) -> Float[Array, ""]:
    """Mean with weights of the same shape; their sum counts as at least 1."""
    return (x * weights).sum() / jnp.maximum(weights.sum(), 1.0)
