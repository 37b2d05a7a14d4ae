"""Colour and depth images of a scene."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Float

from sfgs_jax.datasets.synthetic._furnished_room import ROOM_SIZE
from sfgs_jax.datasets.synthetic._raycast import Hits, cast
from sfgs_jax.datasets.synthetic._scene import Scene
from sfgs_jax.datasets.synthetic._textures import surface_colours
from sfgs_jax.geometry import Camera, se3

# XLA's loops on a CPU are several times slower where their length isn't a multiple of the vector width.
LANES = 16
"""Rays are padded to a multiple of this."""
_AMBIENT = 0.7
_LAMPS = ((-1.2, -0.6, ROOM_SIZE[2] - 0.1), (1.3, 0.7, ROOM_SIZE[2] - 0.1))


class IdealView(eqx.Module):
    """The images of an ideal camera.

    Attributes:
        rgb: RGB in [0, 1].
        depth: metres along z at pixel centres; 0 if there is no surface.
        facing: cosine between the surface's normal and the ray back to the camera.
    """

    rgb: Float[Array, "h w 3"]
    depth: Float[Array, "h w"]
    facing: Float[Array, "h w"]


@jax.jit
def render_view(scene: Scene, camera: Camera, T_world_cam: jaxlie.SE3) -> IdealView:
    """Ray-cast depth at pixel centres, and colour averaged over each pixel's centre and corners.

    Args:
        scene: the triangles.
        camera: intrinsics of the images.
        T_world_cam: pose.
    """
    height, width = camera.shape
    corner_u, corner_v = jnp.meshgrid(
        jnp.arange(width + 1, dtype=jnp.float32) - 0.5, jnp.arange(height + 1, dtype=jnp.float32) - 0.5
    )
    corner_pixels = jnp.stack([corner_u, corner_v], axis=-1).reshape(-1, 2)
    pixels = jnp.concatenate([camera.pixels().reshape(-1, 2), corner_pixels])
    pixels = jnp.pad(pixels, ((0, -len(pixels) % LANES), (0, 0)))

    triangles = se3.transform(se3.inverse(T_world_cam), scene.triangles)
    hits = cast(triangles, camera, pixels)
    rgb, facing = shade(scene, unit_normals(triangles), camera, T_world_cam, pixels, hits)
    centres = height * width
    corner = rgb[centres : centres + len(corner_pixels)].reshape(height + 1, width + 1, 3)
    corners = (corner[:-1, :-1] + corner[:-1, 1:] + corner[1:, :-1] + corner[1:, 1:]) / 4
    return IdealView(
        rgb=(rgb[:centres].reshape(height, width, 3) + corners) / 2,
        depth=hits.depth[:centres].reshape(height, width),
        facing=facing[:centres].reshape(height, width),
    )


def unit_normals(triangles: Float[Array, "t 3 3"]) -> Float[Array, "t 3"]:
    """Normals that point to the side from which a triangle is seen."""
    normals = jnp.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return normals / jnp.linalg.norm(normals, axis=1, keepdims=True)


def shade(
    scene: Scene,
    normals: Float[Array, "t 3"],
    camera: Camera,
    T_world_cam: jaxlie.SE3,
    pixels: Float[Array, "n 2"],
    hits: Hits,
) -> tuple[Float[Array, "n 3"], Float[Array, " n"]]:
    """Lambert shading by two ceiling lamps without shadows.

    It is the same from every direction, so it is a property of the scene that a map can hold.

    Args:
        scene: the triangles.
        normals: unit normals of the triangles in camera coordinates.
        camera: camera of the rays.
        T_world_cam: pose.
        pixels: pixels (u, v) of the rays.
        hits: the nearest triangle on each.

    Returns:
        Colour of the hits, and the cosine between their normal and the ray back to the camera.
    """
    points = camera.unproject(pixels, hits.depth)
    triangle = jnp.maximum(hits.triangle, 0)
    normal = normals[triangle]
    distance = jnp.maximum(jnp.linalg.norm(points, axis=1), 1e-6)
    facing = -jnp.sum(points * normal, axis=1) / distance
    footprint = distance / camera.fx / jnp.maximum(facing, 0.1)

    world = se3.transform(T_world_cam, points)
    colour = surface_colours(
        scene.materials, scene.waves, scene.material[triangle], world - scene.origin[triangle], footprint
    )
    world_normal = normal @ se3.rotation_matrix(T_world_cam).T
    light = jnp.full(len(points), _AMBIENT, jnp.float32)
    for lamp in _LAMPS:
        to_lamp = jnp.asarray(lamp, jnp.float32)[None] - world
        squared = jnp.sum(to_lamp**2, axis=1)
        cosine = jnp.maximum(jnp.sum(to_lamp * world_normal, axis=1) * jax.lax.rsqrt(squared + 0.05), 0)
        light = light + 1.4 * cosine / (2.0 + squared)
    rgb = jnp.clip(colour * light[:, None], 0, 1)
    return jnp.where((hits.triangle >= 0)[:, None], rgb, 0), facing
