"""New Gaussians where a view shows surface that the map lacks: small ones where there is detail.

The image is divided like a quadtree. A cell that one colour and one surface fill gets a Gaussian of its size.
Any other is divided into four, down to the smallest size. So textured and bent surface gets many Gaussians
and a bare wall few, as in section 3.2 of SFGS-SLAM.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
from jax.lax import Precision
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.arrays import rounded_up
from sfgs_jax.geometry import Camera, Surface, downscale_depth, downscale_rgb, se3, surface
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
    behind = (depth > 0) & (rendered.depth > depth * (1 + config.depth_margin))
    return (rendered.alpha < config.min_alpha) | behind


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
    missing: Bool[Array, "h w"],
    camera: Camera,
    T_world_cam: jaxlie.SE3,
    config: SeedingConfig,
) -> tuple[Parameters, Bool[Array, " m"]]:
    """A Gaussian for every cell of every size, and which of them are wanted."""
    shape = surface(depth, camera)
    rgb, depth = _whole_cells(rgb, depth, config.max_cell)
    size, parts = config.max_cell, []
    undecided = jnp.ones((depth.shape[0] // size, depth.shape[1] // size), bool)
    while size >= config.min_cell:
        colour, z, uniform = _cell_means(rgb, depth, size, config)
        keep = undecided & (uniform | (size == config.min_cell))
        values, covered = _seeds(colour, z, shape, missing, camera, T_world_cam, size, config)
        wanted = keep & (z > 0) & (z < config.max_depth) & covered
        parts.append((values, wanted.reshape(-1)))
        undecided = jnp.repeat(jnp.repeat(undecided & ~keep, 2, axis=0), 2, axis=1)
        size //= 2
    values = {name: jnp.concatenate([part[name] for part, _ in parts]) for name in parts[0][0]}
    return values, jnp.concatenate([wanted for _, wanted in parts])


def _whole_cells(
    rgb: Float[Array, "h w 3"], depth: Float[Array, "h w"], size: int
) -> tuple[Float[Array, "H W 3"], Float[Array, "H W"]]:
    """The images filled up to whole cells, by pixels without depth."""
    h, w = depth.shape
    room = ((0, rounded_up(h, size) - h), (0, rounded_up(w, size) - w))
    return jnp.pad(rgb, (*room, (0, 0)), mode="edge"), jnp.pad(depth, room)


def _cell_means(
    rgb: Float[Array, "h w 3"], depth: Float[Array, "h w"], size: int, config: SeedingConfig
) -> tuple[Float[Array, "y x 3"], Float[Array, "y x"], Bool[Array, "y x"]]:
    """Mean colour of each cell, depth of its nearest surface, and whether one colour and surface fill it."""
    colour, square = downscale_rgb(rgb, size), downscale_rgb(rgb**2, size)
    deviation = jnp.sqrt(jnp.max(jnp.maximum(square - colour**2, 0), axis=-1))
    h, w = depth.shape
    cells = depth.reshape(h // size, size, w // size, size)
    nearest, farthest = jnp.min(cells, axis=(1, 3)), jnp.max(cells, axis=(1, 3))
    one_surface = (nearest > 0) & (farthest < nearest * (1 + config.depth_margin))
    return colour, downscale_depth(depth, size), one_surface & (deviation <= config.colour_tolerance)


def _seeds(
    colour: Float[Array, "y x 3"],
    z: Float[Array, "y x"],
    shape: Surface,
    missing: Bool[Array, "h w"],
    camera: Camera,
    T_world_cam: jaxlie.SE3,
    size: int,
    config: SeedingConfig,
) -> tuple[Parameters, Bool[Array, "y x"]]:
    """A Gaussian for each cell of one size, and whether the map lacks the surface at its middle."""
    rows, columns = (jnp.arange(n, dtype=z.dtype) * size + (size - 1) / 2 for n in z.shape)
    v, u = jnp.meshgrid(rows, columns, indexing="ij")
    row, column = (
        jnp.minimum(x.astype(jnp.int32), length - 1) for x, length in zip((v, u), camera.shape, strict=True)
    )
    points = camera.unproject(jnp.stack([u, v], axis=-1), jnp.where(z > 0, z, 1)).reshape(-1, 3)
    # At depth edges there is no plane to fit; a disc that faces the camera covers its pixels.
    facing = -points / jnp.linalg.norm(points, axis=-1, keepdims=True)
    fitted = shape.valid[row, column].reshape(-1, 1)
    normals = jnp.where(fitted, shape.normals[row, column].reshape(-1, 3), facing)

    # Side of the cell on the surface: longer down a slope by the cosine of its slant.
    side = size * points[:, 2] / camera.fx
    cosine = jnp.abs(jnp.sum(normals * points, axis=-1)) / jnp.linalg.norm(points, axis=-1)
    across = config.scale * side
    scales = jnp.stack([across, across / jnp.maximum(cosine, 0.25), config.thickness * across], axis=-1)
    frames = _tangent_frames(normals, points)
    rotations = jnp.matmul(se3.rotation_matrix(T_world_cam), frames, precision=Precision.HIGHEST)
    opacity = config.opacity
    values = {
        "means": se3.transform(T_world_cam, points),
        "quaternions": se3.quaternions(rotations),
        "log_scales": jnp.log(scales),
        "opacity_logits": jnp.full(len(points), jnp.log(opacity / (1 - opacity)), z.dtype),
        "sh": rgb_to_sh(colour.reshape(-1, 3))[:, None, :],
    }
    return values, missing[row, column]


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
    """Put a Gaussian into a free slot for every cell of a view whose surface is missing from the map.

    Args:
        gaussian_map: before.
        rgb: colours of the view in the map's exposure.
        depth: of the view, metres along z; 0 where missing.
        missing: pixels whose surface the map lacks.
        camera: intrinsics of the view.
        T_world_cam: its pose.
        keyframe: number of the keyframe that the new Gaussians belong to.
        config: settings.

    Returns:
        The map with those Gaussians, and the number of seeds for which there was no room.
    """
    values, wanted = _candidates(rgb, depth, missing, camera, T_world_cam, config)
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
