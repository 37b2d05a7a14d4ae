"""Direct alignment: the pose at which a recorded image agrees with a rendering of the map.

The rendering gives colour and depth at a pose near the camera's. Its pixels are moved to the camera by their
depth, and the recorded image is read there. Gain and offset of the image are unknowns beside the motion.
Gauss-Newton is inverse compositional: the Jacobian is that of the rendering, so it is computed once for each
resolution. Coarse resolutions come first, because an image is about linear over a pixel, but not over more.

Source: Baker and Matthews, Lucas-Kanade 20 years on (2004), section 3.2; Engel et al., Direct sparse odometry
(2018), for gain and offset.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
from jax.lax import Precision
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.arrays import checked, masked_median
from sfgs_jax.geometry import Camera, downscale_depth, kernel_weight, se3
from sfgs_jax.splatting._rendering import RenderOutput

_MIN_ALPHA = 0.9
"""Opacity of the rendering below which its colours are mixed with the background."""
_KERNEL_WIDTH = 2.385
"""Width of the Cauchy kernel, in standard deviations: 95 % efficient for normal errors."""
_NORMAL_MAD = 1.4826
"""Standard deviation of a normal distribution over its median of absolute deviations."""
_MIN_DEVIATION = 0.004
"""Least standard deviation of a colour: images have 256 levels."""
_MAX_STEPS = 12
"""Gauss-Newton steps at a resolution."""
_STILL = 0.002
"""Pixels by which a step must move the image for another to follow."""


class ImageAlignment(eqx.Module):
    """Result of a direct alignment.

    Attributes:
        T_world_cam: pose of the camera.
        information: (6, 6) of its tangent: the precision, if the errors of the pixels were independent.
        gain: factor on the rendering's grey values that gives the image's.
        offset: added to them.
        rmse: of the weighted residuals, grey values in [0, 1].
        inlier_fraction: share of the image's pixels that took part and agree within the kernel's width.
    """

    T_world_cam: jaxlie.SE3
    information: Float[Array, "6 6"]
    gain: Float[Array, ""]
    offset: Float[Array, ""]
    rmse: Float[Array, ""]
    inlier_fraction: Float[Array, ""]


class _Level(eqx.Module):
    """One resolution of the rendering and of the image.

    Attributes:
        points: (3, N) in the rendering's camera, metres.
        grey: (N,) of the rendering.
        columns: (8, N) derivatives of the grey values by the motion, and the columns of gain and offset.
        usable: (N,) pixels that take part.
        image: (h, w) grey values of the image; -1 where it holds none.
        camera: of this resolution.
    """

    points: Float[Array, "3 n"]
    grey: Float[Array, " n"]
    columns: Float[Array, "8 n"]
    usable: Bool[Array, " n"]
    image: Float[Array, "h w"]
    camera: Camera


class _Estimate(eqx.Module):
    """Motion of the camera from the rendering's, gain and offset, and the equations that they solve."""

    T_rendered_cam: jaxlie.SE3
    gain: Float[Array, ""]
    offset: Float[Array, ""]
    normal_matrix: Float[Array, "8 8"]
    squares: Float[Array, ""]
    inliers: Float[Array, ""]


@checked
@partial(jax.jit, static_argnames="levels")
def align_image(
    rgb: Float[Array, "H W 3"],
    valid: Bool[Array, "H W"],
    rendered: RenderOutput,
    camera: Camera,
    T_world_cam: jaxlie.SE3,
    *,
    levels: int = 3,
) -> ImageAlignment:
    """Pose of a camera by its image and a rendering of the map from nearby.

    Args:
        rgb: the camera's image, in [0, 1].
        valid: its pixels that hold an image.
        rendered: the map's image; pixels that are not opaque take no part.
        camera: intrinsics of both.
        T_world_cam: pose of the rendering.
        levels: resolutions, each half the one before; the coarsest finds motions of some 2^levels pixels.

    Returns:
        The alignment. Without any texture the pose is that of the rendering, and the information is zero.
    """
    image, shown = jnp.where(valid, jnp.mean(rgb, axis=-1), -1), jnp.mean(rendered.rgb, axis=-1)
    depth = jnp.where(rendered.alpha > _MIN_ALPHA, rendered.depth, 0)
    pyramid = [(image, shown, depth, camera)]
    for _ in range(levels - 1):
        image, shown, depth, finer = pyramid[-1]
        pyramid.append((_halved(image), _halved(shown), downscale_depth(depth, 2), finer.downscaled(2)))
    zero = jnp.zeros((), rgb.dtype)
    estimate = _Estimate(se3.identity(rgb.dtype), zero + 1, zero, jnp.zeros((8, 8), rgb.dtype), zero, zero)
    for image, shown, depth, smaller in reversed(pyramid):
        estimate = _refined(_level(image, shown, depth, smaller), estimate)
    information = _of_motion(estimate.normal_matrix)
    pixels = jnp.maximum(jnp.sum(valid, dtype=rgb.dtype), 1)
    return ImageAlignment(
        T_world_cam=se3.compose(T_world_cam, estimate.T_rendered_cam),
        information=information,
        gain=estimate.gain,
        offset=estimate.offset,
        rmse=jnp.sqrt(estimate.squares),
        inlier_fraction=estimate.inliers / pixels,
    )


def _halved(image: Float[Array, "h w"]) -> Float[Array, "h2 w2"]:
    """Means of 2 x 2 blocks; -1 where one of the four is negative."""
    h, w = image.shape[0] // 2 * 2, image.shape[1] // 2 * 2
    pixels = [image[i:h:2, j:w:2] for i in range(2) for j in range(2)]
    lowest = jnp.minimum(jnp.minimum(pixels[0], pixels[1]), jnp.minimum(pixels[2], pixels[3]))
    return jnp.where(lowest < 0, -1, (pixels[0] + pixels[1] + pixels[2] + pixels[3]) / 4)


def _level(
    image: Float[Array, "h w"], shown: Float[Array, "h w"], depth: Float[Array, "h w"], camera: Camera
) -> _Level:
    known = depth > 0
    inner = known[1:-1, 2:] & known[1:-1, :-2] & known[2:, 1:-1] & known[:-2, 1:-1] & known[1:-1, 1:-1]
    along_u = jnp.pad((shown[:, 2:] - shown[:, :-2]) / 2, ((0, 0), (1, 1))).reshape(-1)
    along_v = jnp.pad((shown[2:] - shown[:-2]) / 2, ((1, 1), (0, 0))).reshape(-1)
    usable = jnp.pad(inner, 1).reshape(-1)
    z = jnp.where(known, depth, 1)
    points = camera.unproject(camera.pixels(), z).reshape(-1, 3).T
    x, y, z = points
    # A camera that moves by (v, w) sees the point move by -v - w x p.
    a, b = along_u * camera.fx / z, along_v * camera.fy / z
    c = -(a * x + b * y) / z
    columns = [-a, -b, -c, y * -c + z * b, z * -a + x * c, x * -b + y * a]
    grey = shown.reshape(-1)
    columns = [jnp.where(usable, column, 0) for column in (*columns, grey, jnp.ones_like(grey))]
    return _Level(points, grey, jnp.stack(columns), usable, image, camera)


def _read(image: Float[Array, "h w"], pixels: Float[Array, "2 n"]) -> Float[Array, " n"]:
    """The image between its pixels, bilinear; -1 outside and where a neighbour holds nothing."""
    h, w = image.shape
    u, v = pixels
    left, top = jnp.clip(jnp.floor(u), 0, w - 2), jnp.clip(jnp.floor(v), 0, h - 2)
    s, t = u - left, v - top
    place = top.astype(jnp.int32) * w + left.astype(jnp.int32)
    flat = image.reshape(-1)
    corners = [flat[place], flat[place + 1], flat[place + w], flat[place + w + 1]]
    value = (1 - t) * ((1 - s) * corners[0] + s * corners[1]) + t * ((1 - s) * corners[2] + s * corners[3])
    lowest = jnp.minimum(jnp.minimum(corners[0], corners[1]), jnp.minimum(corners[2], corners[3]))
    inside = (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1) & (lowest >= 0)
    return jnp.where(inside, value, -1)


def _refined(level: _Level, start: _Estimate) -> _Estimate:
    """The estimate after Gauss-Newton steps at one resolution."""
    residuals, usable = _residuals(level, start)
    deviation = jnp.maximum(_NORMAL_MAD * masked_median(jnp.abs(residuals), usable), _MIN_DEVIATION)

    def step(state: tuple[Int[Array, ""], Float[Array, ""], _Estimate]) -> tuple:
        number, _, estimate = state
        residuals, usable = _residuals(level, estimate)
        whitened = (residuals / deviation) ** 2
        weights = jnp.where(usable, kernel_weight(whitened, "cauchy", _KERNEL_WIDTH), 0)
        weighted = level.columns * weights[None]
        normal = jnp.matmul(weighted, level.columns.T, precision=Precision.HIGHEST)
        right = jnp.matmul(weighted, residuals, precision=Precision.HIGHEST)
        change = _solved(normal, right)
        motion = -change[:6] / estimate.gain
        inliers = jnp.sum(usable & (whitened <= _KERNEL_WIDTH**2), dtype=residuals.dtype)
        total = jnp.maximum(jnp.sum(weights), 1)
        after = _Estimate(
            T_rendered_cam=se3.compose(se3.exp(motion), estimate.T_rendered_cam),
            gain=jnp.clip(estimate.gain + change[6], 0.25, 4),
            offset=estimate.offset + change[7],
            normal_matrix=normal * (estimate.gain / deviation) ** 2,
            squares=jnp.sum(weights * residuals**2) / total,
            inliers=inliers,
        )
        return number + 1, _flow(level, motion), after

    def more(state: tuple) -> Bool[Array, ""]:
        number, moved, _ = state
        return (number < _MAX_STEPS) & (moved > _STILL)

    first = (jnp.zeros((), jnp.int32), jnp.full((), jnp.inf, residuals.dtype), start)
    return jax.lax.while_loop(more, step, first)[-1]


def _residuals(level: _Level, estimate: _Estimate) -> tuple[Float[Array, " n"], Bool[Array, " n"]]:
    """The image where the rendering's pixels lie in it, less the rendering with gain and offset."""
    T = se3.inverse(estimate.T_rendered_cam)
    x, y, z = (
        jnp.matmul(se3.rotation_matrix(T), level.points, precision=Precision.HIGHEST) + T.wxyz_xyz[4:, None]
    )
    camera, ahead = level.camera, z > 0
    z = jnp.where(ahead, z, 1)
    seen = _read(level.image, jnp.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy]))
    usable = level.usable & ahead & (seen >= 0)
    return jnp.where(usable, seen - estimate.gain * level.grey - estimate.offset, 0), usable


def _solved(normal: Float[Array, "8 8"], right: Float[Array, "8"]) -> Float[Array, "8"]:
    """Solution of the normal equations, zero along what they don't fix; columns scaled first."""
    scale = jnp.sqrt(jnp.maximum(jnp.diagonal(normal), 1e-12))
    scaled = normal / jnp.outer(scale, scale) + 1e-4 * jnp.eye(8, dtype=normal.dtype)
    return jnp.linalg.solve(scaled, right / scale) / scale


def _flow(level: _Level, motion: Float[Array, "6"]) -> Float[Array, ""]:
    """Motion of the image by a motion of the camera, pixels, at the nearest surface."""
    nearest = jnp.min(jnp.where(level.usable, level.points[2], jnp.inf))
    pixels = level.camera.fx * (jnp.linalg.norm(motion[:3]) / nearest + jnp.linalg.norm(motion[3:]))
    return jnp.where(jnp.isfinite(nearest), pixels, 0)


def _of_motion(normal: Float[Array, "8 8"]) -> Float[Array, "6 6"]:
    """Information of the motion once gain and offset are eliminated."""
    brightness = normal[6:, 6:]
    determinant = brightness[0, 0] * brightness[1, 1] - brightness[0, 1] ** 2
    known = determinant > 1e-6 * brightness[0, 0] * brightness[1, 1]
    safe = jnp.where(known, brightness, jnp.eye(2, dtype=normal.dtype))
    coupling = jnp.matmul(normal[:6, 6:], jnp.linalg.solve(safe, normal[6:, :6]), precision=Precision.HIGHEST)
    return jnp.where(known, normal[:6, :6] - coupling, 0)
