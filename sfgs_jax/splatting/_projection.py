"""EWA splatting: from 3-D Gaussians to their images.

The image of a Gaussian has the 2 x 2 covariance Σ = M Mᵀ + 0.3 I with M = J R S. S holds the scales, R is
the rotation to camera axes, and J the derivative of the projection at the centre. Pixels need Σ⁻¹. It is kept
as the triangle U of Σ⁻¹ = Uᵀ U. So the exponent -|U d|² / 2 is a sum of squares.

With m₁ and m₂ the rows of M, det Σ = |m₁ x m₂|² + 0.3 (|m₁|² + |m₂|²) + 0.09 (Cauchy-Binet). Nothing cancels
in it. So U is accurate in float32 even for a needle that is hundreds of pixels long and half a pixel wide.
The entries of Σ⁻¹ would not be.

Under a rolling shutter a Gaussian is seen where it lies when its row is exposed. The row is the one that it
would have without motion: it moves by a few pixels, which changes the time by some ten microseconds.

While a row gathers light a Gaussian moves along b, and its image is the mean over that. Its covariance is
S = Σ + b bᵀ / 12 and its weight √(det Σ / det S), so b / √12 is a fourth column of M. The covariance
is exact, and the shape about right while b is not much longer than the Gaussian.

All products are written out as sums of elementwise ones, which run in float32 on every device.

Source: Zwicker et al., EWA splatting, 2002; Kerbl et al., 3D Gaussian splatting, 2023; Seiskari et al.,
Gaussian splatting on the move, 2024 (rolling shutter, motion blur).
"""

import math
from functools import partial, reduce
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Bool, Float

from sfgs_jax.arrays import checked, dot, map_used_rows, side_by_side
from sfgs_jax.geometry import Camera, se3
from sfgs_jax.sensors import RollingShutter, carried, row_places, velocities
from sfgs_jax.splatting._config import DEFAULT, RenderConfig
from sfgs_jax.splatting._gaussians import Gaussians, require_scene
from sfgs_jax.splatting._spherical_harmonics import sh_colours
from sfgs_jax.splatting._surface_depth import slopes_of_inverse_depth
from sfgs_jax.splatting._thresholds import LOW_PASS, MIN_ALPHA

_VIEW_MARGIN = 0.3
"""Share of the image's half size. J is taken no farther outside the image, where the linearisation fails."""

_MAX_LOG_IMAGE_SIZE = 20.0
"""Logarithm of the largest standard deviation an image may have, pixels: 5e8, far beyond any screen."""

_LEAST_LENGTH = 1e-30
"""Largest entry of a quaternion that counts as zero."""


class Projected(eqx.Module):
    """Images of N Gaussians.

    Attributes:
        centres: (N, 2) pixels (u, v).
        whitening: (N, 3) entries p, q, r of U = [[p, q], [0, r]], 1 / pixels; Σ⁻¹ = Uᵀ U.
        log_opacities: (N,) logarithms of the opacities.
        depths: (N,) depths of the centres along z, metres.
        visible: (N,) which Gaussians are drawn; the other lanes hold finite values.
        inverse_depth_slopes: (N, 2) change of inverse depth along u and v on the surface that the Gaussian
            stands for, 1 / (metres pixels). None if the settings do not ask for it.
    """

    centres: Float[Array, "n 2"]
    whitening: Float[Array, "n 3"]
    log_opacities: Float[Array, " n"]
    depths: Float[Array, " n"]
    visible: Bool[Array, " n"]
    inverse_depth_slopes: Float[Array, "n 2"] | None = None


@checked
def project(
    gaussians: Gaussians,
    camera: Camera,
    T_world_cam: se3.Pose,
    shutter: RollingShutter | None = None,
    *,
    config: RenderConfig = DEFAULT,
) -> tuple[Projected, Float[Array, "n 3"]]:
    """Images of the Gaussians, and their RGB as seen from the camera.

    Reverse-mode differentiable once; there is no forward mode. Gradients are zero in lanes that are not
    visible. A Gaussian is visible if it is in use, lies in [near, far], is opaque enough and reaches the
    image. One that holds a NaN, or an image too large for float32, is not.

    Args:
        gaussians: the map.
        camera: intrinsics and image size.
        T_world_cam: pose of the camera, `jaxlie.SE3` or a homogeneous 4 x 4 matrix.
        shutter: its motion while the rows are exposed, then the pose is that of the middle row; None for an
            image taken at once.
        config: settings, static; only `near`, `far`, `antialiased` and `surface_depth` have an
            influence.

    Returns:
        The images, and the RGB (N, 3) of the spherical harmonics.

    Raises:
        InputError: the harmonics are not of degree 0 to 3, or the pose is none.
    """
    require_scene(gaussians, camera)
    pose = se3.as_se3(T_world_cam, name="T_world_cam")
    return _project(gaussians, camera, pose, shutter, config)


# Compiled here: hundreds of small programs would take longer. Inside a caller's jit it is inlined.
@partial(jax.jit, static_argnames="config")
def _project(
    gaussians: Gaussians,
    camera: Camera,
    T_world_cam: jaxlie.SE3,
    shutter: RollingShutter | None,
    config: RenderConfig,
) -> tuple[Projected, Float[Array, "n 3"]]:
    view = (camera, T_world_cam, shutter)

    def of_rows(rows: _Rows, valid: Array, view: _View) -> tuple[tuple, Array]:
        return _project_rows(rows, valid, *view, config)

    rows = _Rows(
        means=_columns(gaussians.means),
        quaternions=_columns(gaussians.quaternions),
        log_scales=_columns(gaussians.log_scales),
        opacity_logits=gaussians.opacity_logits,
        sh=gaussians.sh,
    )
    mapped: tuple[tuple, Array] = map_used_rows(of_rows, rows, gaussians.valid, view)
    (centres, whitening, log_opacities, depths, rgb, slopes), visible = mapped
    projected = Projected(
        centres=side_by_side(centres),
        whitening=side_by_side(whitening),
        log_opacities=log_opacities,
        depths=depths,
        visible=visible,
        inverse_depth_slopes=side_by_side(slopes) if slopes else None,
    )
    return projected, rgb


_View = tuple[Camera, jaxlie.SE3, RollingShutter | None]


class _Rows(NamedTuple):
    """Parameters of Gaussians, vectors as lists of columns, which XLA fuses and compiles sooner."""

    means: list[Array]
    quaternions: list[Array]
    log_scales: list[Array]
    opacity_logits: Array
    sh: Array


def _project_rows(
    rows: _Rows,
    valid: Bool[Array, " n"],
    camera: Camera,
    T_world_cam: jaxlie.SE3,
    shutter: RollingShutter | None,
    config: RenderConfig,
) -> tuple[tuple[list[Array], list[Array], Array, Array, Array, list[Array]], Bool[Array, " n"]]:
    """Centres, whitening, logarithms of the opacities, depths, RGB and slopes; the mask of the visible."""
    R_cam_world = se3.rotation_matrix(T_world_cam).T
    # Relative to the camera before anything else: far from the origin float32 has no digits to spare.
    origin = T_world_cam.wxyz_xyz[4:]
    offset = [mean - origin[i] for i, mean in enumerate(rows.means)]
    z = dot(R_cam_world[2], offset)
    used = valid & (z > config.near) & (z < config.far) & _computable(rows, camera, z)

    # Lanes not in use are replaced on the way in, so that no NaN arises there, nor in a gradient.
    offset = [jnp.where(used, o, axis) for o, axis in zip(offset, R_cam_world[2], strict=True)]
    quaternion = [jnp.where(used, q, 1) for q in rows.quaternions]
    scale = [jnp.exp(jnp.where(used, s, 0)) for s in rows.log_scales]
    logits = jnp.where(used, rows.opacity_logits, 0)
    sh = jnp.where(used[:, None, None], rows.sh, 0)

    x, y, z = (dot(row, offset) for row in R_cam_world)
    if shutter is not None:
        x, y, z = _when_exposed(x, y, z, camera, shutter)
    u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    axes = rotation_columns(quaternion)
    slopes_uv = _clipped_slopes(x / z, y / z, camera)
    m1, m2 = _image_axes(slopes_uv, z, axes, scale, camera, R_cam_world)

    blur = None
    if shutter is not None and shutter.exposure is not None:
        blur = _blur(jnp.stack([x, y, z]), slopes_uv, camera, shutter.twist, shutter.exposure)
    uu, vv, uv, determinant, log_weight = _covariance(m1, m2, blur, antialiased=config.antialiased)
    log_opacities = jax.nn.log_sigmoid(logits) + log_weight

    reach = 2 * (log_opacities - math.log(MIN_ALPHA))
    inside = [
        (centre + extent >= 0) & (centre - extent <= size - 1)
        for centre, extent, size in (
            (u, jnp.sqrt(jnp.maximum(reach, 0) * uu), camera.width),
            (v, jnp.sqrt(jnp.maximum(reach, 0) * vv), camera.height),
        )
    ]
    visible = used & (reach >= 0) & inside[0] & inside[1]
    p = jnp.sqrt(vv / determinant)
    whitening = [p, -p * uv / vv, 1 / jnp.sqrt(vv)]
    slopes: list[Array] = []
    if config.surface_depth:
        m3 = [dot(R_cam_world[2], axis) * s for axis, s in zip(axes, scale, strict=True)]
        slopes = slopes_of_inverse_depth(m1, m2, m3, z)
    rgb = sh_colours(sh, jnp.stack(offset, axis=-1))
    return ([u, v], whitening, log_opacities, z, rgb, slopes), visible


def _when_exposed(
    x: Float[Array, " n"],
    y: Float[Array, " n"],
    z: Float[Array, " n"],
    camera: Camera,
    shutter: RollingShutter,
) -> tuple[Float[Array, " n"], Float[Array, " n"], Float[Array, " n"]]:
    """Points in the camera of the time at which their rows are exposed."""
    # Rows beyond the image's are exposed never; what reaches in from there belongs to the outermost.
    places = jnp.clip(row_places(camera.fy * y / z + camera.cy, camera.height), -0.5, 0.5)
    x, y, moved = carried(jnp.stack([x, y, z]), shutter.twist, -shutter.readout * places)
    return x, y, jnp.maximum(moved, z / 2)


def _covariance(
    m1: list[Array], m2: list[Array], blur: tuple[Array, Array] | None, *, antialiased: bool
) -> tuple[Array, Array, Array, Array, Array | float]:
    """Σ by its entries uu, vv and uv and its determinant, and the logarithm of the image's weight."""
    uu, vv, uv = dot(m1, m1), dot(m2, m2), dot(m1, m2)
    minors = [m1[i] * m2[j] - m1[j] * m2[i] for i, j in ((0, 1), (1, 2), (2, 0))]
    raw_determinant = dot(minors, minors)
    determinant = _widened(raw_determinant, uu, vv)
    # An image of this determinant has the Gaussian's own opacity. Spread farther it is fainter.
    opaque = raw_determinant if antialiased else determinant
    if blur is not None:
        b1, b2 = blur
        minors = [m1[i] * b2 - b1 * m2[i] for i in range(3)]
        uu, vv, uv = uu + b1 * b1, vv + b2 * b2, uv + b1 * b2
        determinant = _widened(raw_determinant + dot(minors, minors), uu, vv)
    log_weight: Array | float = 0.0
    if antialiased or blur is not None:
        log_weight = 0.5 * jnp.log(jnp.maximum(opaque / determinant, 1e-12))
    return uu + LOW_PASS, vv + LOW_PASS, uv, determinant, log_weight


def _widened(determinant: Array, uu: Array, vv: Array) -> Array:
    """Determinant of a covariance after the low pass."""
    return determinant + LOW_PASS * (uu + vv) + LOW_PASS**2


def _blur(
    points: Float[Array, "3 n"],
    slopes: tuple[Array, Array],
    camera: Camera,
    twist: Float[Array, "6"],
    exposure: Float[Array, ""],
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Standard deviation of the image's place along u and v while its row gathers light, with signs."""
    x, y, z = velocities(points, twist)
    share = exposure / (math.sqrt(12) * points[2])
    return camera.fx * share * (x - slopes[0] * z), camera.fy * share * (y - slopes[1] * z)


def _columns(vectors: Float[Array, "n d"]) -> list[Array]:
    return [vectors[:, i] for i in range(vectors.shape[1])]


def _clipped_slopes(
    x: Float[Array, " n"], y: Float[Array, " n"], camera: Camera
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Slopes x / z and y / z of the rays at which J is taken."""
    # Pixels cover half a unit around their centres, so the image spans [-0.5, size - 0.5].
    margin_u = _VIEW_MARGIN * camera.width / (2 * camera.fx)
    margin_v = _VIEW_MARGIN * camera.height / (2 * camera.fy)
    slope_u = jnp.clip(
        x,
        -(camera.cx + 0.5) / camera.fx - margin_u,
        (camera.width - 0.5 - camera.cx) / camera.fx + margin_u,
    )
    slope_v = jnp.clip(
        y,
        -(camera.cy + 0.5) / camera.fy - margin_v,
        (camera.height - 0.5 - camera.cy) / camera.fy + margin_v,
    )
    return slope_u, slope_v


def _image_axes(
    slopes: tuple[Array, Array],
    z: Float[Array, " n"],
    axes: list[list[Array]],
    scale: list[Array],
    camera: Camera,
    R_cam_world: Float[Array, "3 3"],
) -> tuple[list[Array], list[Array]]:
    """Rows of M = J R S: the image's motion in u and in v along each axis of the Gaussian, by one sigma."""
    slope_u, slope_v = slopes
    right, down, forward = R_cam_world
    # The rows of J times the rotation to camera axes.
    j1 = [camera.fx / z * (right[i] - slope_u * forward[i]) for i in range(3)]
    j2 = [camera.fy / z * (down[i] - slope_v * forward[i]) for i in range(3)]
    m1 = [dot(j1, axis) * s for axis, s in zip(axes, scale, strict=True)]
    m2 = [dot(j2, axis) * s for axis, s in zip(axes, scale, strict=True)]
    return m1, m2


def _computable(rows: _Rows, camera: Camera, z: Float[Array, " n"]) -> Bool[Array, " n"]:
    """Mask of the Gaussians without NaN whose images have fourth powers within float32."""
    # Column by column, because reductions over a short axis are slow.
    largest = reduce(jnp.maximum, rows.log_scales)
    size = largest + jnp.log(jnp.maximum(camera.fx, camera.fy) / z)
    numbers = [*rows.quaternions, *_columns(rows.sh.reshape(rows.sh.shape[0], -1))]
    return (
        (size < _MAX_LOG_IMAGE_SIZE)  # False where NaN
        & reduce(jnp.logical_and, map(jnp.isfinite, numbers))
        & ~jnp.isnan(rows.opacity_logits)
    )


def rotation_columns(quaternion: list[Array]) -> list[list[Array]]:
    """Columns of the rotation matrices of quaternions wxyz of any length; a zero one does not rotate."""
    # The length has no influence. Taken out as a constant, it lets nothing over- or underflow. Quaternions so
    # short that a GPU has no reciprocal of their length count as zero.
    largest = jax.lax.stop_gradient(reduce(jnp.maximum, map(jnp.abs, quaternion)))
    rotates = largest > _LEAST_LENGTH
    w, x, y, z = (jnp.where(rotates, q / jnp.where(rotates, largest, 1), 0) for q in quaternion)
    # Twice the product of two entries of the unit quaternion is `two` times that of the given one.
    two = 2 / jnp.where(rotates, w * w + x * x + y * y + z * z, 1)
    return [
        [1 - two * (y * y + z * z), two * (x * y + w * z), two * (x * z - w * y)],
        [two * (x * y - w * z), 1 - two * (x * x + z * z), two * (y * z + w * x)],
        [two * (x * z + w * y), two * (y * z - w * x), 1 - two * (x * x + y * y)],
    ]
