"""Ray casting of triangles from a pinhole camera, whose rows may have a pose each."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.geometry import Camera, se3

# Triangles are tested in groups of this many, so that rays are read and written once for each group.
_GROUP = 8
# Shared edges must not leak: a ray this close outside an edge (of 1 across the triangle) still hits.
_EDGE_TOLERANCE = 1e-5
# Rows whose culling is one step: more of them at once need memory for nothing.
_ROWS_AT_ONCE = 16


class Hits(eqx.Module):
    """Nearest triangle on each ray.

    Attributes:
        triangle: index of the triangle, or -1.
        depth: along the camera's z, metres; 0 if nothing is hit.
    """

    triangle: Int[Array, "*n"]
    depth: Float[Array, "*n"]


def cast(triangles: Float[Array, "t 3 3"], camera: Camera, pixels: Float[Array, "n 2"]) -> Hits:
    """Ray casting after Möller and Trumbore, of triangles in camera coordinates; back faces are invisible.

    All rays start at the origin, so the method's determinants are linear in the direction d = (x, y, 1). Let
    s = -v0 and k = e2·(s × e1). Then 1/z = d·(e2 × e1)/k. The barycentric coordinates over z are d·(e2 × s)/k
    and d·(s × e1)/k. The nearest hit has the largest 1/z.

    Source: Möller and Trumbore, Fast, Minimum Storage Ray/Triangle Intersection, 1997.

    Args:
        triangles: corners, metres, counter-clockwise from the visible side.
        camera: camera of the rays.
        pixels: pixels (u, v) of the rays, also outside the image.
    """
    forms, facing = _forms(triangles)
    visible = facing & _in_view(triangles, camera)
    forms = jnp.where(visible[:, None, None], forms, 0)
    order, num_groups = _groups(visible)
    forms = jnp.pad(forms, ((0, 1), (0, 0), (0, 0)))[order]
    return _nearest(lambda i: forms[i], order, num_groups, *_ray_slopes(camera, pixels))


def cast_rows(
    triangles: Float[Array, "t 3 3"],
    camera: Camera,
    T_world_row: jaxlie.SE3,
    pixels: Float[Array, "r n 2"],
) -> Hits:
    """Ray casting as by `cast`, of a camera that has moved between the rows of its image.

    Args:
        triangles: corners in world coordinates, metres, counter-clockwise from the visible side.
        camera: camera of the rays.
        T_world_row: (r,) poses, one for each row of rays.
        pixels: pixels (u, v) of the rays, also outside the image.
    """

    def from_row(pose: jaxlie.SE3, triangles: Float[Array, "k 3 3"]) -> Float[Array, "k 3 3"]:
        return se3.transform(se3.inverse(pose), triangles)

    def visible_from(pose: jaxlie.SE3) -> Bool[Array, " t"]:
        moved = from_row(pose, triangles)
        return _forms(moved)[1] & _in_view(moved, camera)

    visible = jnp.any(jax.lax.map(visible_from, T_world_row, batch_size=_ROWS_AT_ONCE), axis=0)
    order, num_groups = _groups(visible)
    # A triangle without area, which is never hit, fills the last group.
    groups = jnp.pad(triangles, ((0, 1), (0, 0), (0, 0)))[order]

    def forms_of(i: Array) -> Float[Array, "g 3 3 r 1"]:
        # Made where they are used: those of all triangles and rows would not fit into memory.
        forms, _ = _forms(jax.vmap(from_row, in_axes=(0, None))(T_world_row, groups[i]))
        return jnp.moveaxis(forms, 0, -1)[..., None]

    return _nearest(forms_of, order, num_groups, *_ray_slopes(camera, pixels))


def _ray_slopes(
    camera: Camera, pixels: Float[Array, "*n 2"]
) -> tuple[Float[Array, "*n"], Float[Array, "*n"]]:
    """x and y of the rays (x, y, 1) through pixels."""
    return (pixels[..., 0] - camera.cx) / camera.fx, (pixels[..., 1] - camera.cy) / camera.fy


def _forms(triangles: Float[Array, "*b 3 3"]) -> tuple[Float[Array, "*b 3 3"], Bool[Array, "*b"]]:
    """Linear forms of a ray, by rows: 1/z and the two barycentric coordinates over z.

    Returns:
        The forms, which are zero and so never hit for back faces, and which triangles are front faces.
    """
    v0 = triangles[..., 0, :]
    e1, e2 = triangles[..., 1, :] - v0, triangles[..., 2, :] - v0
    k = jnp.sum(e2 * jnp.cross(-v0, e1), axis=-1)
    facing = k > 1e-9
    scale = jnp.where(facing, 1 / jnp.where(facing, k, 1), 0)[..., None, None]
    return jnp.stack([jnp.cross(e2, e1), jnp.cross(e2, -v0), jnp.cross(-v0, e1)], axis=-2) * scale, facing


def _groups(visible: Bool[Array, " t"]) -> tuple[Int[Array, "m g"], Int[Array, ""]]:
    """Indices of triangles in groups, visible ones first, and the number of groups that have some.

    The index past the last triangle fills the last group.
    """
    order = jnp.argsort(~visible, stable=True)  # visible ones first, so that the loop can end early
    order = jnp.pad(order, (0, -len(visible) % _GROUP), constant_values=len(visible))
    num_groups = (jnp.sum(visible) + _GROUP - 1) // _GROUP
    return order.astype(jnp.int32).reshape(-1, _GROUP), num_groups.astype(jnp.int32)


def _nearest(
    forms_of: Callable[[Array], Float[Array, "g 3 3 *b"]],
    order: Int[Array, "m g"],
    num_groups: Int[Array, ""],
    x: Float[Array, "*n"],
    y: Float[Array, "*n"],
) -> Hits:
    """The nearest triangle on each ray (x, y, 1), one group after the other.

    Args:
        forms_of: forms of the triangles of a group, whose last axes broadcast with the rays.
        order: index of each triangle of the groups.
        num_groups: groups to test.
        x: of the rays.
        y: of the rays.
    """

    def test_group(i: Array, best: tuple[Array, Array]) -> tuple[Array, Array]:
        nearness, triangle = best
        group, indices = forms_of(i), order[i]
        for j in range(_GROUP):
            a, b, c = (row[0] * x + (row[1] * y + row[2]) for row in group[j])
            slack = _EDGE_TOLERANCE * a
            hit = (b >= -slack) & (c >= -slack) & (b + c <= a + slack) & (a > nearness)
            nearness = jnp.where(hit, a, nearness)
            triangle = jnp.where(hit, indices[j], triangle)
        return nearness, triangle

    start = (jnp.zeros_like(x), jnp.full(x.shape, -1, jnp.int32))
    nearness, triangle = jax.lax.fori_loop(0, num_groups, test_group, start)
    depth = jnp.where(triangle >= 0, 1 / jnp.where(triangle >= 0, nearness, 1), 0)
    return Hits(triangle, depth)


def _in_view(triangles: Float[Array, "t 3 3"], camera: Camera) -> Bool[Array, " t"]:
    """Frustum culling with a margin of a pixel: False if all corners lie beyond one side of the image."""
    x, y, z = triangles[..., 0], triangles[..., 1], triangles[..., 2]
    left = camera.fx * x + (camera.cx + 1) * z
    right = -camera.fx * x + (camera.width - camera.cx) * z
    top = camera.fy * y + (camera.cy + 1) * z
    bottom = -camera.fy * y + (camera.height - camera.cy) * z
    return jnp.all(jnp.stack([jnp.any(side > 0, axis=1) for side in (left, right, top, bottom, z)]), axis=0)
