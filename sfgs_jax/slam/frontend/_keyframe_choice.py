"""Choice of keyframes: when a frame that was found becomes one."""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from sfgs_jax.geometry import se3
from sfgs_jax.slam.config import TrackingConfig
from sfgs_jax.slam.state._frame_features import FrameFeatures
from sfgs_jax.slam.state._registration import Registration


@partial(jax.jit, static_argnames="config", inline=True)
def needs_keyframe(found: Registration, config: TrackingConfig) -> Bool[Array, ""]:
    """True if the camera has left the reference so far that the frame should be a keyframe.

    Args:
        found: registration of the frame to its reference.
        config: settings.
    """
    moved = se3.log(found.T_target_source)
    little = found.inlier_fraction < config.keyframe_inlier_fraction
    far = jnp.linalg.norm(moved[:3]) > config.keyframe_translation
    turned = jnp.linalg.norm(moved[3:]) > config.keyframe_rotation
    return (config.use_surface & little) | far | turned


def runs_out_of_keypoints(
    found: Registration, seen: FrameFeatures, config: TrackingConfig
) -> Bool[Array, ""]:
    """True if the reference's keypoints will soon be too few to be believed, and the frame has many others.

    A pose that they no longer support makes no keyframe, so it has to be taken before.

    Args:
        found: registration of the frame to its reference.
        seen: features of the frame.
        config: settings.
    """
    left, features = found.matched.num_inliers, config.features
    dtype = found.T_target_source.wxyz_xyz.dtype
    # Keypoints decide alone along a direction that the surface leaves free.
    share = jnp.where(found.num_free > 0, features.min_inlier_share_alone, 0)
    least = jnp.maximum(features.min_inliers_alone, share * found.matched.num_matches.astype(dtype))
    more = jnp.sum(seen.keypoints.measured, dtype=jnp.int32) > 2 * left
    return found.by_keypoints & (left.astype(dtype) < config.keyframe_margin * least) & more
