"""New Gaussians where a keyframe shows surface that the map lacks."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
from jax.lax import Precision
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.geometry import Camera, se3, surface
from sfgs_jax.slam.config import SeedingConfig
from sfgs_jax.slam.state._gaussian_map import GaussianMap, Parameters
from sfgs_jax.splatting import GAUSSIAN_PARAMETERS, Gaussians, RenderOutput, rgb_to_sh


def uncovered(
    rendered: RenderOutput, depth: Float[Array, "h w"], config: SeedingConfig
) -> Bool[Array, "h w"]:
    """Pixels whose surface the map lacks: too transparent there, or the map's surface lies behind.

    Args:
        rendered: the map as the view's camera sees it.
        depth: of the view, metres along z; 0 where it is missing.
        config: settings.
    """
    return (rendered.alpha < config.min_alpha) | (rendered.depth > depth * (1 + config.depth_margin))


def _tangent_frames(normals: Float[Array, "n 3"], points: Float[Array, "n 3"]) -> Float[Array, "n 3 3"]:
    """Rotations whose columns are: along the surface across the view, along its slope, its normal."""
    across = jnp.cross(normals, points)
    # Seen head-on the slope has no direction; any tangent does, and the camera's x axis gives one.
    fallback = jnp.cross(normals, jnp.asarray([0.0, 1.0, 0.0], normals.dtype))
    slanted = jnp.linalg.norm(across, axis=-1, keepdims=True) > 1e-3 * points[..., 2:]
    across = jnp.where(slanted, across, fallback)
    across = across / jnp.maximum(jnp.linalg.norm(across, axis=-1, keepdims=True), 1e-9)
    return jnp.stack([across, jnp.cross(normals, across), normals], axis=-1)


def _candidates(
    rgb: Float[Array, "h w 3"],
    depth: Float[Array, "h w"],
    camera: Camera,
    T_world_cam: jaxlie.SE3,
    config: SeedingConfig,
) -> tuple[Parameters, Bool[Array, " m"], Int[Array, " m"]]:
    """A Gaussian for every seed pixel, which of them are usable, and their pixels' flat indices."""
    stride = config.stride
    rows, columns = jnp.meshgrid(
        jnp.arange(stride // 2, camera.height, stride),
        jnp.arange(stride // 2, camera.width, stride),
        indexing="ij",
    )
    pixel = (rows * camera.width + columns).reshape(-1)
    z = depth.reshape(-1)[pixel]
    usable = (z > 0) & (z < config.max_depth)
    points = camera.unproject(camera.pixels().reshape(-1, 2)[pixel], jnp.where(usable, z, 1))
    shape = surface(depth, camera)
    # At depth edges there is no plane to fit; a disc that faces the camera covers its pixels.
    facing = -points / jnp.linalg.norm(points, axis=-1, keepdims=True)
    fitted = shape.valid.reshape(-1)[pixel]
    normals = jnp.where(fitted[:, None], shape.normals.reshape(-1, 3)[pixel], facing)

    # Spacing of the seeds on the surface: wider down a slope by the cosine of its slant.
    spacing = stride * points[:, 2] / camera.fx
    cosine = jnp.abs(jnp.sum(normals * points, axis=-1)) / jnp.linalg.norm(points, axis=-1)
    across = config.scale * spacing
    scales = jnp.stack([across, across / jnp.maximum(cosine, 0.25), config.thickness * across], axis=-1)
    frames = _tangent_frames(normals, points)
    rotations = jnp.matmul(se3.rotation_matrix(T_world_cam), frames, precision=Precision.HIGHEST)
    opacity = config.opacity
    return (
        {
            "means": se3.transform(T_world_cam, points),
            "quaternions": se3.quaternions(rotations),
            "log_scales": jnp.log(scales),
            "opacity_logits": jnp.full(pixel.shape, jnp.log(opacity / (1 - opacity)), depth.dtype),
            "sh": rgb_to_sh(rgb.reshape(-1, 3)[pixel])[:, None, :],
        },
        usable,
        pixel,
    )


@eqx.filter_jit
def seed(
    gaussian_map: GaussianMap,
    rgb: Float[Array, "h w 3"],
    depth: Float[Array, "h w"],
    missing: Bool[Array, "h w"],
    camera: Camera,
    T_world_cam: jaxlie.SE3,
    keyframe: Int[Array, ""],
    config: SeedingConfig,
) -> tuple[GaussianMap, Int[Array, ""]]:
    """Put a Gaussian into a free slot for every seed pixel that is missing from the map.

    They belong to the keyframe of the given number.

    Returns:
        The map with those Gaussians, and the number of seeds for which there was no room.
    """
    values, usable, pixel = _candidates(rgb, depth, camera, T_world_cam, config)
    wanted = usable & missing.reshape(-1)[pixel]
    valid = gaussian_map.gaussians.valid
    capacity, amount = valid.shape[0], wanted.shape[0]
    free = jnp.nonzero(~valid, size=amount, fill_value=capacity)[0]
    slots = jnp.where(wanted, free[jnp.cumsum(wanted) - 1], capacity)

    def put(old: Array, new: Array | float | bool) -> Array:
        return old.at[slots].set(new, mode="drop")

    gaussians = gaussian_map.gaussians
    nothing = dict.fromkeys(GAUSSIAN_PARAMETERS, 0.0)
    return GaussianMap(
        gaussians=Gaussians(
            **{name: put(getattr(gaussians, name), value) for name, value in values.items()},
            valid=put(valid, True),
        ),
        first_moment=jax.tree.map(put, gaussian_map.first_moment, nothing),
        second_moment=jax.tree.map(put, gaussian_map.second_moment, nothing),
        updates=put(gaussian_map.updates, 0.0),
        keyframes=put(gaussian_map.keyframes, keyframe),
    ), jnp.maximum(jnp.sum(wanted) - jnp.sum(~valid), 0)
