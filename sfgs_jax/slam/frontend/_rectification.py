"""Rectification of a frame: its features as a global shutter at the frame's time would have seen them.

A frame that others are registered to is rectified once its motion is known. After that it has one pose, and
nobody who uses it need know about rows. A frame that is registered is not: its rows move with the motion
that is sought.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax import gicp
from sfgs_jax.arrays import dot
from sfgs_jax.geometry import Camera
from sfgs_jax.sensors import carried, row_places, turned
from sfgs_jax.slam.state._frame_features import FrameFeatures, Keypoints


@jax.jit
def rectified(features: FrameFeatures, camera: Camera, moving: gicp.RowMotion) -> FrameFeatures:
    """Features of a frame in the camera of its time, colour's middle row.

    Args:
        features: of a frame as it was read.
        camera: intrinsics.
        moving: motion while it was read.
    """
    cloud = gicp.OrganisedCloud(tuple(_rectified_level(level, moving) for level in features.cloud.levels))
    keypoints = with_depth_in_time(features, camera, moving)
    return FrameFeatures(cloud, _rectified_keypoints(keypoints, camera, moving), features.grey)


@jax.jit
def with_depth_in_time(features: FrameFeatures, camera: Camera, moving: gicp.RowMotion) -> Keypoints:
    """Keypoints of a frame with the depth that their surface had when colour was exposed.

    Between the exposures of a pixel's colour and depth the camera moves, and its depth is that of another
    point. The surface there, as a plane, is moved to colour's time and met with the keypoint's ray.

    Args:
        features: of a frame as it was read.
        camera: intrinsics.
        moving: motion while it was read.
    """
    keypoints, level = features.keypoints, features.cloud.levels[0]
    pixels, height = keypoints.features.keypoints, camera.height
    rays = camera.unproject(pixels, jnp.ones_like(keypoints.depth)).T
    places = row_places(pixels[:, 1], height)
    exposed = moving.timing.colour_times(places)
    ahead = moving.timing.depth_times(places) - exposed
    at = camera.project(carried(keypoints.points.T, moving.twist, -ahead).T)
    ahead = moving.timing.depth_times(row_places(at[:, 1], height)) - exposed

    # Both by planes, so that without motion the depth stays what was measured. In one call: less to compile.
    twice, times = jnp.concatenate([rays, rays], axis=1), jnp.concatenate([jnp.zeros_like(ahead), ahead])
    depths = _depth_along(level, camera, jnp.concatenate([pixels, at]), twice, moving.twist, times)
    still, then = jnp.split(depths, 2)
    both = (still > 0) & (then > 0)
    depth = keypoints.depth * jnp.where(both, then / jnp.where(both, still, 1), 1)
    points = camera.unproject(pixels, jnp.where(depth > 0, depth, 1))
    return replace(keypoints, depth=depth, points=points)


def on_their_planes(keypoints: Keypoints, pixels: Float[Array, "k 2"], camera: Camera) -> Keypoints:
    """Keypoints at other pixels of their image, at the depth of their surfaces there.

    Args:
        keypoints: where they were detected; one without a normal keeps its depth.
        pixels: (u, v) where they are.
        camera: intrinsics.
    """
    rays, normals = camera.unproject(pixels, jnp.ones_like(keypoints.depth)).T, keypoints.normals.T
    along, distance = dot(normals, rays), dot(normals, keypoints.points.T)
    on_plane = (along < -0.1) & (keypoints.depth > 0)
    depth = jnp.where(on_plane, distance / jnp.where(on_plane, along, 1), keypoints.depth)
    points = camera.unproject(pixels, jnp.where(depth > 0, depth, 1))
    features = replace(keypoints.features, keypoints=pixels)
    return replace(keypoints, features=features, depth=depth, points=points)


def _depth_along(
    level: gicp.OrganisedLevel,
    camera: Camera,
    pixels: Float[Array, "k 2"],
    rays: Float[Array, "3 k"],
    twist: Float[Array, "6"],
    times: Float[Array, " k"],
) -> Float[Array, " k"]:
    """Depth along rays of the planes at some pixels, seen at some times; 0 where a plane or ray has none."""
    height, width = level.camera.shape
    u, v = jnp.round(level.camera.project(camera.unproject(pixels, jnp.ones_like(times)))).astype(jnp.int32).T
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    row, column = jnp.where(inside, v, 0), jnp.where(inside, u, 0)
    surface = level.surface[row, column].T
    points, normals = carried(surface[:3], twist, times), turned(surface[3:], twist, times)
    # Beyond 84 degrees a pixel's width becomes ten in depth.
    along = dot(normals, rays)
    known = inside & level.valid[row, column] & (along < -0.1 * jnp.sqrt(dot(rays, rays)))
    return jnp.where(known, jnp.maximum(dot(normals, points) / jnp.where(known, along, 1), 0), 0)


def origins(camera: Camera, moved: Float[Array, "3 N"]) -> tuple[Int[Array, " N"], Bool[Array, " N"]]:
    """Which pixel's surface each pixel shows after a small motion, and whether the image had that pixel.

    Found by the flow at the pixel itself, which is smooth but for depth edges.

    Args:
        camera: of the image.
        moved: (3, N) where the surface of each pixel is now, row by row.
    """
    height, width = camera.shape
    u, v = jnp.round(2 * camera.pixels().reshape(-1, 2) - camera.project(moved.T)).astype(jnp.int32).T
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    return jnp.where(inside, v * width + u, 0), inside


def on_pixels(
    level: gicp.OrganisedLevel,
    points: Float[Array, "3 N"],
    normals: Float[Array, "3 N"],
    valid: Bool[Array, " N"],
) -> gicp.OrganisedLevel:
    """A level with another surface, whose planes are met by the rays of the pixels.

    A surface that lies beside its pixels, be it by a part of one, pulls GICP aside where planes meet.

    Args:
        level: of the same camera.
        points: (3, N) within a pixel of each ray, row by row.
        normals: (3, N) likewise, unit vectors.
        valid: (N,) whether there is a surface.
    """
    camera = level.camera
    rays = camera.unproject(camera.pixels().reshape(-1, 2), jnp.ones_like(points[0])).T
    along = dot(normals, rays)
    # Beyond 84 degrees a pixel's width becomes ten in depth.
    valid &= along < -0.1 * jnp.sqrt(dot(rays, rays))
    met = rays * (dot(normals, points) / jnp.where(valid, along, 1))[None]
    surface = jnp.where(valid[None], jnp.concatenate([met, normals]), 0)
    return replace(level, surface=surface.T.reshape(level.surface.shape), valid=valid.reshape(camera.shape))


def _rectified_keypoints(keypoints: Keypoints, camera: Camera, moving: gicp.RowMotion) -> Keypoints:
    """Keypoints, with depth in time, in the camera of the frame's time."""
    pixels = keypoints.features.keypoints
    times = moving.timing.colour_times(row_places(pixels[:, 1], camera.height))
    measured = keypoints.depth > 0
    # Without depth nothing is known about the effect of a translation.
    turns = turned(keypoints.points.T, moving.twist, times)
    points = jnp.where(measured[None], carried(keypoints.points.T, moving.twist, times), turns).T
    return replace(
        keypoints,
        features=replace(keypoints.features, keypoints=camera.project(points)),
        depth=jnp.where(measured, points[:, 2], 0),
        points=points,
    )


def _rectified_level(level: gicp.OrganisedLevel, moving: gicp.RowMotion) -> gicp.OrganisedLevel:
    """Surface of a level on the pixels of the camera of the frame's time.

    Each pixel takes the surface of the pixel that moves to it.
    """
    camera = level.camera
    places = row_places(jnp.arange(camera.height, dtype=level.surface.dtype), camera.height)
    times = jnp.broadcast_to(moving.timing.depth_times(places)[:, None], camera.shape).reshape(-1)
    pixels, valid = camera.pixels().reshape(-1, 2), level.valid.reshape(-1)
    rays = camera.unproject(pixels, jnp.ones_like(times))
    seen = jnp.where(valid[:, None], level.points.reshape(-1, 3), rays)
    index, inside = origins(camera, carried(seen.T, moving.twist, times))

    surface, at, valid = level.surface.reshape(-1, 6)[index].T, times[index], valid[index] & inside
    points, normals = carried(surface[:3], moving.twist, at), turned(surface[3:], moving.twist, at)
    return on_pixels(level, points, normals, valid)
