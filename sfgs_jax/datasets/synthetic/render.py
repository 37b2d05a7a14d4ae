"""Colour and depth images of a scene."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Float

from sfgs_jax.datasets.synthetic.raycast import Hits, cast
from sfgs_jax.datasets.synthetic.scene import ROOM_SIZE, Scene
from sfgs_jax.datasets.synthetic.textures import surface_colours
from sfgs_jax.geometry import Camera, se3

_AMBIENT = 0.7
_LAMPS = ((-1.2, -0.6, ROOM_SIZE[2] - 0.1), (1.3, 0.7, ROOM_SIZE[2] - 0.1))


class View(eqx.Module):
    """What an ideal camera sees.

    Attributes:
        rgb: (H, W, 3) in [0, 1].
        depth: (H, W) metres along z at pixel centres; 0 where there is nothing.
        facing: (H, W) cosine between the surface's normal and the ray back to the camera.
    """

    rgb: Float[Array, "h w 3"]
    depth: Float[Array, "h w"]
    facing: Float[Array, "h w"]


@jax.jit
def render_view(scene: Scene, camera: Camera, T_world_cam: jaxlie.SE3) -> View:
    """Ray-cast depth at pixel centres, and colour averaged over each pixel's centre and corners."""
    corner_camera = _corner_camera(camera)
    triangles = se3.transform(se3.inverse(T_world_cam), scene.triangles)
    centre_hits = cast(triangles, camera, camera.pixels())
    centre, facing = _shade(scene, triangles, camera, T_world_cam, centre_hits)
    corner_hits = cast(triangles, corner_camera, corner_camera.pixels())
    corner, _ = _shade(scene, triangles, corner_camera, T_world_cam, corner_hits)
    corners = (corner[:-1, :-1] + corner[:-1, 1:] + corner[1:, :-1] + corner[1:, 1:]) / 4
    return View((centre + corners) / 2, centre_hits.depth, facing)


def _corner_camera(camera: Camera) -> Camera:
    """Camera whose pixel centres are the corners of this one's pixels."""
    return Camera(
        camera.fx,
        camera.fy,
        camera.cx + 0.5,
        camera.cy + 0.5,
        width=camera.width + 1,
        height=camera.height + 1,
    )


def _shade(
    scene: Scene, triangles: Float[Array, "t 3 3"], camera: Camera, T_world_cam: jaxlie.SE3, hits: Hits
) -> tuple[Float[Array, "h w 3"], Float[Array, "h w"]]:
    """Colour of hits, and how far their surface faces the camera.

    Lambert shading by two ceiling lamps without shadows: the same from every direction, so that it is a
    property of the scene that a map can hold.
    """
    points = camera.unproject(camera.pixels(), hits.depth).reshape(-1, 3)
    triangle = jnp.maximum(hits.triangle.ravel(), 0)
    normals = jnp.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals = normals / jnp.linalg.norm(normals, axis=1, keepdims=True)
    normal = normals[triangle]
    distance = jnp.maximum(jnp.linalg.norm(points, axis=1), 1e-6)
    facing = -jnp.sum(points * normal, axis=1) / distance
    footprint = distance / camera.fx / jnp.maximum(facing, 0.1)

    world = se3.transform(T_world_cam, points)
    colour = surface_colours(scene.materials, scene.waves, scene.material[triangle], world, footprint)
    world_normal = normal @ se3.rotation_matrix(T_world_cam).T
    light = jnp.full(len(points), _AMBIENT, jnp.float32)
    for lamp in _LAMPS:
        to_lamp = jnp.asarray(lamp, jnp.float32) - world
        squared = jnp.sum(to_lamp**2, axis=1)
        cosine = jnp.maximum(jnp.sum(to_lamp * world_normal, axis=1) * jax.lax.rsqrt(squared + 0.05), 0)
        light = light + 1.4 * cosine / (2.0 + squared)
    rgb = jnp.clip(colour * light[:, None], 0, 1)
    rgb = jnp.where((hits.triangle.ravel() >= 0)[:, None], rgb, 0)
    return rgb.reshape(*camera.shape, 3), facing.reshape(camera.shape)
