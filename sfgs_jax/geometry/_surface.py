"""Local planes of a depth image: points, normals and covariances from window moments.

A plane is linear in *inverse* depth over the image: n . P = h with P = z (x, y, 1) gives
1/z = (n_x x + n_y y + n_z) / h. So a plane is fitted to the moments of (u, v, 1/z) over a window. Its
normal, facing the camera, follows in closed form. The noise of a structured-light sensor is even in that
space, for its depth error grows as z². The moments are box sums of shifted slices.
"""

from collections.abc import Callable
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Bool, Float

from sfgs_jax.arrays import InputError, checked
from sfgs_jax.geometry._camera import Camera
from sfgs_jax.geometry._depth_cleaning import clean_depth


class Surface(eqx.Module):
    """Points, normals and covariances of the surface at each pixel of a depth image.

    Attributes:
        points: (H, W, 3) camera coordinates, metres: where the pixel's ray meets the fitted plane.
        normals: (H, W, 3) unit normals of the fitted plane, facing the camera.
        covariances: (H, W, 3, 3) of the window's points, square metres, to first order.
        valid: (H, W) the pixel has depth and its window fits a plane; all else is 0 where it is False.
    """

    points: Float[Array, "H W 3"]
    normals: Float[Array, "H W 3"]
    covariances: Float[Array, "H W 3 3"]
    valid: Bool[Array, "H W"]


class _Moments(eqx.Module):
    """Covariances of (column, row, inverse depth) over each pixel's window, and the fitted plane there.

    Attributes:
        uu, uv, vv: window covariances of the pixel offsets, square pixels.
        ud, vd, dd: the same with inverse depth.
        slope_u, slope_v: gradient of the fitted inverse depth, 1 / (m pixel).
        inverse_depth: of the fitted plane at the window's centre, 1 / m.
        valid: whether there is such a fit.
    """

    uu: Float[Array, "H W"]
    uv: Float[Array, "H W"]
    vv: Float[Array, "H W"]
    ud: Float[Array, "H W"]
    vd: Float[Array, "H W"]
    dd: Float[Array, "H W"]
    slope_u: Float[Array, "H W"]
    slope_v: Float[Array, "H W"]
    inverse_depth: Float[Array, "H W"]
    valid: Bool[Array, "H W"]


@checked
def surface(
    depth: Float[Array | np.ndarray, "H W"],
    camera: Camera,
    *,
    radius: int = 2,
    edge_tolerance: float = 0.02,
    min_fill: float = 0.5,
) -> Surface:
    """Points, normals and covariances of an organised depth image.

    Args:
        depth: metres along z; anything not finite or not positive is missing.
        camera: intrinsics of the depth image.
        radius: windows are (2 radius + 1) pixels square; static. A larger one averages out the sensor's
            noise and quantisation, and loses more along depth edges.
        edge_tolerance: a window straddles a depth edge, and is rejected, if the root mean square distance
            of its inverse depths from their plane is above this share of the inverse depth.
        min_fill: the least share of a window's pixels that must have depth.

    Raises:
        InputError: `depth` does not have the camera's size, or the radius is below 1.
    """
    if depth.shape != camera.shape:
        raise InputError(
            f"The depth image is {depth.shape}, but its camera is {camera.shape} (rows, columns)."
        )
    if radius < 1:
        raise InputError(f"A window needs a radius of at least 1 pixel, not {radius}.")
    return _surface(jnp.asarray(depth), camera, radius, edge_tolerance, min_fill)


@partial(jax.jit, static_argnames="radius")
def _surface(
    depth: Float[Array, "H W"], camera: Camera, radius: int, edge_tolerance: ArrayLike, min_fill: ArrayLike
) -> Surface:
    depth, measured = clean_depth(depth)
    m = _in_memory(lambda d: _fit(d, measured, radius, edge_tolerance, min_fill), depth)
    points, normals = _planes(m, camera)
    return Surface(points, normals, _covariances(m, points, camera), m.valid)


def _padded(images: tuple[Array, ...], radius: int, axis: int) -> tuple[Array, ...]:
    """Images with a margin of zeros along an axis."""
    margin = [(radius, radius) if i == axis else (0, 0) for i in range(2)]
    return tuple(jnp.pad(image, margin) for image in images)


def _in_memory(fit: Callable[[Array], _Moments], depth: Float[Array, "H W"]) -> _Moments:
    """Result of `fit` on a depth image that has any depth, else zeros.

    The branch also makes XLA keep the result in memory. Without it the window sums are computed anew for each
    array made from them, at several times the cost.
    """
    nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(fit, depth))
    return lax.cond(jnp.any(depth > 0), fit, lambda _: nothing, depth)


def _window_sums(
    d: Float[Array, "H W"], has: Float[Array, "H W"], radius: int
) -> tuple[Float[Array, "H W"], ...]:
    """Sums over every window of 1, u, u², s, u s, s², v, u v, v² and v s, with s the change of inverse depth.

    Inverse depths are summed as differences from the window's own centre: along the row first, then, moved
    to the centre's row, along the column. Sums of the squares themselves would lose the plane in float32.
    """
    height, width = d.shape
    padded = _padded((has, d), radius, axis=1)
    n = u = uu = s = us = ss = jnp.zeros_like(d)
    for i in range(-radius, radius + 1):
        has_i, d_i = (x[:, radius + i : radius + i + width] for x in padded)
        delta = has_i * (d_i - d)
        n, u, uu = n + has_i, u + i * has_i, uu + i * i * has_i
        s, us, ss = s + delta, us + i * delta, ss + delta * delta
    padded = _padded((n, u, uu, s, us, ss, d), radius, axis=0)

    n = u = uu = s = us = ss = v = uv = vv = vs = jnp.zeros_like(d)
    for k in range(-radius, radius + 1):
        n_k, u_k, uu_k, s_k, us_k, ss_k, d_k = (x[radius + k : radius + k + height] for x in padded)
        move = d_k - d
        s_moved = s_k + n_k * move
        n, u, uu = n + n_k, u + u_k, uu + uu_k
        v, uv, vv = v + k * n_k, uv + k * u_k, vv + k * k * n_k
        s, vs, us = s + s_moved, vs + k * s_moved, us + us_k + u_k * move
        ss = ss + ss_k + move * (s_k + s_moved)
    return n, u, uu, s, us, ss, v, uv, vv, vs


def _fit(
    depth: Float[Array, "H W"],
    measured: Bool[Array, "H W"],
    radius: int,
    edge_tolerance: ArrayLike,
    min_fill: ArrayLike,
) -> _Moments:
    """Moments and plane fit of every window."""
    d = jnp.where(measured, 1 / jnp.where(measured, depth, 1), 0)
    n, u, uu, s, us, ss, v, uv, vv, vs = _window_sums(d, measured.astype(depth.dtype), radius)
    scale = 1 / jnp.maximum(n, 1)
    mean_u, mean_v, mean_s = u * scale, v * scale, s * scale
    cov_uu, cov_uv, cov_vv = uu * scale - mean_u**2, uv * scale - mean_u * mean_v, vv * scale - mean_v**2
    cov_ud, cov_vd = us * scale - mean_u * mean_s, vs * scale - mean_v * mean_s
    cov_dd = jnp.maximum(ss * scale - mean_s**2, 0)

    determinant = cov_uu * cov_vv - cov_uv**2
    spread = determinant > 0.05 * radius**4 / 9  # a full window has (radius (radius + 1) / 3)²
    inverse = 1 / jnp.where(spread, determinant, 1)
    slope_u = (cov_vv * cov_ud - cov_uv * cov_vd) * inverse
    slope_v = (cov_uu * cov_vd - cov_uv * cov_ud) * inverse
    fitted = d + mean_s - slope_u * mean_u - slope_v * mean_v
    variance = cov_dd - slope_u * cov_ud - slope_v * cov_vd
    valid = measured & spread & (n >= min_fill * (2 * radius + 1) ** 2) & (fitted > 0)
    valid &= (variance < (edge_tolerance * d) ** 2) & (jnp.abs(fitted - d) < 2 * edge_tolerance * d)
    return lax.optimization_barrier(
        _Moments(
            uu=cov_uu,
            uv=cov_uv,
            vv=cov_vv,
            ud=cov_ud,
            vd=cov_vd,
            dd=cov_dd,
            slope_u=slope_u,
            slope_v=slope_v,
            inverse_depth=fitted,
            valid=valid,
        )
    )


def _planes(m: _Moments, camera: Camera) -> tuple[Float[Array, "H W 3"], Float[Array, "H W 3"]]:
    """Points and normals of the fitted planes; 0 where there is none."""
    u = jnp.arange(camera.width, dtype=camera.fx.dtype)[None] - camera.cx
    v = jnp.arange(camera.height, dtype=camera.fy.dtype)[:, None] - camera.cy
    z = jnp.where(m.valid, 1 / jnp.where(m.valid, m.inverse_depth, 1), 0)
    x, y = u / camera.fx * z, v / camera.fy * z
    a, b = m.slope_u, m.slope_v
    n_x, n_y, n_z = a * camera.fx, b * camera.fy, m.inverse_depth - a * u - b * v
    square = n_x**2 + n_y**2 + n_z**2
    scale = jnp.where(m.valid, -lax.rsqrt(jnp.where(m.valid, square, 1)), 0)
    normals = jnp.stack([n_x * scale, n_y * scale, n_z * scale], axis=-1)
    return jnp.stack([x, y, z], axis=-1), normals


def _covariances(m: _Moments, points: Float[Array, "H W 3"], camera: Camera) -> Float[Array, "H W 3 3"]:
    """Window covariances of (u, v, inverse depth), carried to 3-D by the Jacobian of unprojection."""
    z, zero = points[..., 2], jnp.zeros_like(m.uu)
    window = jnp.stack([m.uu, m.uv, m.ud, m.uv, m.vv, m.vd, m.ud, m.vd, m.dd], axis=-1)
    jacobian = jnp.stack(
        [
            jnp.stack([z / camera.fx, zero, zero], axis=-1),
            jnp.stack([zero, z / camera.fy, zero], axis=-1),
            -z[..., None] * points,
        ],
        axis=-1,
    )
    shape, exact = (*z.shape, 3, 3), lax.Precision.HIGHEST
    return jnp.einsum("...ij,...jk,...lk->...il", jacobian, window.reshape(shape), jacobian, precision=exact)
