"""Loss of the map: how a rendering differs from a view's image and depth."""

from jaxtyping import Array, Bool, Float

from sfgs_jax.slam.config import OptimisationConfig
from sfgs_jax.splatting import RenderOutput, l1, ssim

_MIN_ALPHA = 0.5
"""Accumulated opacity below which the map's depth says nothing about where its Gaussians should be."""


def mapping_loss(
    out: RenderOutput,
    rgb: Float[Array, "h w 3"],
    depth: Float[Array, "h w"],
    valid: Bool[Array, "h w"],
    config: OptimisationConfig,
) -> Float[Array, ""]:
    """Loss of GS-ICP-SLAM: (1 - w) L1 + w (1 - SSIM) + w_depth L1(depth), the depth where it is measured.

    Args:
        out: the map as the view's camera sees it.
        rgb: the view's colours in [0, 1].
        depth: of the view, metres; 0 where missing.
        valid: pixels that hold colour.
        config: weights.
    """
    similarity = ssim(out.rgb, rgb, valid)
    colour = (1 - config.ssim_weight) * l1(out.rgb, rgb, valid) + config.ssim_weight * (1 - similarity)
    measured = (depth > 0) & (out.alpha > _MIN_ALPHA)
    return colour + config.depth_weight * l1(out.depth, depth, measured)
