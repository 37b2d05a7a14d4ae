"""Depth at the pixel: where the pixel's ray meets the surface that a Gaussian stands for.

A ray meets a Gaussian where its density along the ray is greatest. For a flat Gaussian that is its plane, and
inverse depth on a plane is affine in the pixel:

    1 / depth = 1 / z + s . (pixel - centre).

For others it is so to first order. The slope s is the regression of inverse depth on the pixel. Let m1, m2
and m3 be the changes of u, v and z along the axes of the Gaussian by one sigma, and Σ the image's covariance
before the low-pass filter. Then s = -Σ⁻¹ (m1 . m3, m2 . m3) / z². By the identities of Lagrange and
Cauchy-Binet that is

    s = -(m3 x m2 . c, m1 x m3 . c) / (|c|² z²),  c = m1 x m2,

in which nothing cancels.

The composited inverse depth is the sum of w (1 / z - s . centre), plus the pixel times the sum of w s. These
are three more features, whatever the pixel, so compositing needs no change.

Source: Zhang et al., RaDe-GS: rasterizing depth in Gaussian splatting, 2024 (there for the ray's length).
"""

import math

import jax.numpy as jnp
from jaxtyping import Array, Float

from sfgs_jax.arrays import dot
from sfgs_jax.splatting._thresholds import LOW_PASS, MIN_ALPHA

SOFTENING = 0.01
"""Variance of the image, pixels², below which a Gaussian is seen from its edge and has hardly a slope."""

_REACH = 2 * math.log(1 / MIN_ALPHA)
"""Squared distance, in standard deviations of the image, to which a Gaussian is drawn at most."""

FARTHEST = 2 * math.sqrt(_REACH)
"""Standard deviations along z from the centre beyond which nothing is put."""


def slopes_of_inverse_depth(
    m1: list[Array], m2: list[Array], m3: list[Array], z: Float[Array, " n"]
) -> list[Array]:
    """Slopes of inverse depth along u and v, limited where a Gaussian is seen from its edge.

    Within its image no Gaussian gets a depth beyond `FARTHEST` standard deviations along z. Nor does its
    inverse depth change by more than half.

    Args:
        m1: changes of u along the three axes by one sigma, pixels.
        m2: changes of v.
        m3: changes of z, metres.
        z: depths of the centres, metres.
    """
    uu, uv, vv = dot(m1, m1), dot(m1, m2), dot(m2, m2)
    zu, zv = dot(m3, m1), dot(m3, m2)
    c = _cross(m1, m2)
    determinant = dot(c, c) + SOFTENING * (uu + vv) + SOFTENING**2
    scale = -1 / (determinant * z * z)
    s_u = scale * (dot(_cross(m3, m2), c) + SOFTENING * zu)
    s_v = scale * (dot(_cross(m1, m3), c) + SOFTENING * zv)
    # The square of the greatest change within the image, and the limit of it.
    change = _REACH * (s_u * s_u * (uu + LOW_PASS) + 2 * s_u * s_v * uv + s_v * s_v * (vv + LOW_PASS))
    limit = jnp.minimum(0.25, (FARTHEST / z) ** 2 * dot(m3, m3)) / (z * z)
    above = change > limit
    kept = jnp.where(above, jnp.sqrt(jnp.where(above, limit, 1) / jnp.where(above, change, 1)), 1)
    return [kept * s_u, kept * s_v]


def surface_features(
    centres: Float[Array, "n 2"],
    depths: Float[Array, " n"],
    slopes: Float[Array, "n 2"],
    middle: tuple[float, float],
) -> Float[Array, "n 3"]:
    """Features to composite: inverse depth of each surface at the image's middle, and its slopes.

    Args:
        centres: pixels (u, v).
        depths: metres.
        slopes: of inverse depth along u and v.
        middle: pixel (u, v) from which pixels are counted, which keeps the digits of float32.
    """
    s_u, s_v = slopes[:, 0], slopes[:, 1]
    at_middle = 1 / depths - s_u * (centres[:, 0] - middle[0]) - s_v * (centres[:, 1] - middle[1])
    return jnp.concatenate([at_middle[:, None], slopes], axis=-1)


def surface_depth_of(
    composited: Float[Array, "h w 3"], alpha: Float[Array, "h w"], middle: tuple[float, float]
) -> Float[Array, "h w"]:
    """Depth along z from composited surface features; 0 where alpha is 0.

    Args:
        composited: sums of weights times the features.
        alpha: sums of the weights.
        middle: as of `surface_features`.
    """
    height, width = alpha.shape
    u = (jnp.arange(width, dtype=alpha.dtype) - middle[0])[None]
    v = (jnp.arange(height, dtype=alpha.dtype) - middle[1])[:, None]
    inverse = composited[..., 0] + composited[..., 1] * u + composited[..., 2] * v
    hit = alpha > 0
    return jnp.where(hit, alpha, 0) / jnp.where(hit, inverse, 1)


def _cross(a: list[Array], b: list[Array]) -> list[Array]:
    return [a[i] * b[j] - a[j] * b[i] for i, j in ((1, 2), (2, 0), (0, 1))]
