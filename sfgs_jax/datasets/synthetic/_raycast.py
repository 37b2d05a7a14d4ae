"""Ray casting of triangles from a pinhole camera."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.geometry import Camera

# Triangles are tested in groups of this many, so that rays are read and written once for each group.
_GROUP = 8
# Shared edges must not leak: a ray this close outside an edge (of 1 across the triangle) still hits.
_EDGE_TOLERANCE = 1e-5


class Hits(eqx.Module):
    """Nearest triangle on each ray.

    Attributes:
        triangle: index of the triangle, or -1.
        depth: along the camera's z, metres; 0 if nothing is hit.
    """

    triangle: Int[Array, " n"]
    depth: Float[Array, " n"]


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
    x = (pixels[:, 0] - camera.cx) / camera.fx
    y = (pixels[:, 1] - camera.cy) / camera.fy
    v0 = triangles[:, 0]
    e1, e2 = triangles[:, 1] - v0, triangles[:, 2] - v0
    k = jnp.sum(e2 * jnp.cross(-v0, e1), axis=1)
    visible = (k > 1e-9) & _in_view(triangles, camera)
    scale = jnp.where(visible, 1 / jnp.where(visible, k, 1), 0)[:, None]
    # (T, 3, 3): rows give 1/z and the two barycentric coordinates. Invisible ones are zero, which never hits.
    forms = jnp.stack([jnp.cross(e2, e1), jnp.cross(e2, -v0), jnp.cross(-v0, e1)], axis=1) * scale[..., None]

    order = jnp.argsort(~visible, stable=True)  # visible ones first, so that the loop can end early
    padding = -len(triangles) % _GROUP
    order = jnp.pad(order, (0, padding), constant_values=len(triangles))
    forms = jnp.pad(forms, ((0, 1), (0, 0), (0, 0)))[order].reshape(-1, _GROUP, 3, 3)
    order = order.astype(jnp.int32).reshape(-1, _GROUP)
    num_groups = (jnp.sum(visible) + _GROUP - 1) // _GROUP

    def test_group(i: Array, best: tuple[Array, Array]) -> tuple[Array, Array]:
        nearness, triangle = best
        group, indices = forms[i], order[i]
        for j in range(_GROUP):
            a, b, c = (row[0] * x + (row[1] * y + row[2]) for row in group[j])
            slack = _EDGE_TOLERANCE * a
            hit = (b >= -slack) & (c >= -slack) & (b + c <= a + slack) & (a > nearness)
            nearness = jnp.where(hit, a, nearness)
            triangle = jnp.where(hit, indices[j], triangle)
        return nearness, triangle

    start = (jnp.zeros_like(x), jnp.full(x.shape, -1, jnp.int32))
    nearness, triangle = jax.lax.fori_loop(0, num_groups.astype(jnp.int32), test_group, start)
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
