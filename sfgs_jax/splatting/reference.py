"""Dense reference renderer: every Gaussian at every pixel, gradients by JAX. The oracle of the tests.

It shares classes and constants with the fast renderer, but no code, and writes matrices as the papers do.
Time and memory are N x H x W. All products ask for the highest precision.
"""

import jax
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Float

from sfgs_jax.geometry import Camera, se3
from sfgs_jax.splatting._compositing import MAX_ALPHA, MIN_TRANSMITTANCE
from sfgs_jax.splatting._config import DEFAULT, RenderConfig
from sfgs_jax.splatting._gaussians import Gaussians
from sfgs_jax.splatting._rendering import RenderOutput
from sfgs_jax.splatting._surface_depth import FARTHEST, SOFTENING
from sfgs_jax.splatting._thresholds import LOW_PASS, MIN_ALPHA


def render(
    gaussians: Gaussians,
    camera: Camera,
    T_world_cam: se3.Pose,
    background: Float[Array, "3"] | None = None,
    colours: Float[Array, "n 3"] | None = None,
    features: Float[Array, "n c"] | None = None,
    *,
    config: RenderConfig = DEFAULT,
) -> RenderOutput:
    """Draw the Gaussians as the camera sees them, without tiles.

    Arguments and result are those of `splatting.render`. The tile size and the pair capacity of `config` have
    no influence, and `overflow` and `needed` are 0.
    """
    pose = se3.as_se3(T_world_cam, name="T_world_cam")
    with jax.default_matmul_precision("highest"):
        return _render(gaussians, camera, pose, background, colours, features, config)


def _render(
    gaussians: Gaussians,
    camera: Camera,
    T_world_cam: jaxlie.SE3,
    background: Float[Array, "3"] | None,
    colours: Float[Array, "n 3"] | None,
    features: Float[Array, "n c"] | None,
    config: RenderConfig,
) -> RenderOutput:
    view = jax.vmap(lambda g: _view(g, camera, T_world_cam, config))(gaussians)
    centre, whitening, opacity, colour, depth, slope, drawn = view
    order = jnp.argsort(jnp.where(drawn, depth.astype(jnp.float32), jnp.inf), stable=True)
    centre, whitening, opacity, colour, depth, slope, drawn = (value[order] for value in view)

    def given(values: Array) -> Array:
        return jnp.where(drawn[:, None], values[order], 0)

    colour = colour if colours is None else given(colours)
    channels = jnp.zeros((len(order), 0), depth.dtype) if features is None else given(features)

    def pixel(position: Array) -> tuple[Array, ...]:
        d = position[None] - centre
        alpha = opacity * jnp.exp(-0.5 * jnp.sum(jnp.einsum("nij,nj->ni", whitening, d) ** 2, axis=-1))
        alpha = jnp.where(drawn & (alpha >= MIN_ALPHA), jnp.minimum(alpha, MAX_ALPHA), 0)
        after = jnp.cumprod(1 - alpha)
        before = jnp.concatenate([jnp.ones_like(after[:1]), after[:-1]])
        weight = jnp.where(after >= MIN_TRANSMITTANCE, before * alpha, 0)
        half = jnp.argmax(after <= 0.5)
        median = jnp.where(after[half] <= 0.5, depth[half], 0)
        inverse = weight @ (1 / depth + jnp.sum(slope * d, axis=-1))
        return weight @ colour, weight @ depth, median, jnp.sum(weight), weight @ channels, inverse

    rgb, accumulated, median, alpha, drawn_features, inverse = jax.vmap(jax.vmap(pixel))(
        camera.pixels().astype(depth.dtype)
    )
    if background is not None:
        rgb = rgb + (1 - alpha)[..., None] * background[None, None]
    return RenderOutput(
        rgb=rgb,
        depth=jnp.where(alpha > 0, accumulated / jnp.where(alpha > 0, alpha, 1), 0),
        median_depth=median,
        accumulated_depth=accumulated,
        alpha=alpha,
        features=None if features is None else drawn_features,
        overflow=jnp.int32(0),
        needed=jnp.int32(0),
        surface_depth=jnp.where(alpha > 0, alpha / jnp.where(alpha > 0, inverse, 1), 0)
        if config.surface_depth
        else None,
    )


def _view(
    gaussian: Gaussians, camera: Camera, T_world_cam: jaxlie.SE3, config: RenderConfig
) -> tuple[Array, Array, Array, Array, Array, Array, Array]:
    """Image of one Gaussian.

    Returns:
        Centre (2,), inverse Cholesky factor (2, 2) of the image's covariance, opacity, colour (3,), depth,
        slope (2,) of inverse depth, and whether it is drawn.
    """
    R_world_cam = se3.rotation_matrix(T_world_cam)
    offset = gaussian.means - T_world_cam.wxyz_xyz[4:]
    point = R_world_cam.T @ offset
    drawn = gaussian.valid & (point[2] > config.near) & (point[2] < config.far)

    # A Gaussian that is not drawn is replaced by one that could be, so that no NaN arises.
    offset = jnp.where(drawn, offset, R_world_cam[:, 2])
    quaternion = jnp.where(drawn, gaussian.quaternions, jnp.asarray([1, 0, 0, 0], offset.dtype))
    scale = jnp.exp(jnp.where(drawn, gaussian.log_scales, 0))
    logit = jnp.where(drawn, gaussian.opacity_logits, 0)
    sh = jnp.where(drawn, gaussian.sh, 0)

    x, y, z = R_world_cam.T @ offset
    limit_u, limit_v = 0.3 * camera.width / (2 * camera.fx), 0.3 * camera.height / (2 * camera.fy)
    left, right = (-0.5 - camera.cx) / camera.fx, (camera.width - 0.5 - camera.cx) / camera.fx
    top, bottom = (-0.5 - camera.cy) / camera.fy, (camera.height - 0.5 - camera.cy) / camera.fy
    tx = jnp.clip(x / z, left - limit_u, right + limit_u) * z
    ty = jnp.clip(y / z, top - limit_v, bottom + limit_v) * z
    zero = jnp.zeros_like(z)
    J = jnp.stack(
        [
            jnp.stack([camera.fx / z, zero, -camera.fx * tx / z**2]),
            jnp.stack([zero, camera.fy / z, -camera.fy * ty / z**2]),
        ]
    )
    axes = R_world_cam.T @ _rotation(quaternion) * scale[None]
    M = J @ axes
    (a, b), (_, c) = M @ M.T + LOW_PASS * jnp.eye(2, dtype=z.dtype)
    # det (M Mᵀ) = |m₁ x m₂|² (Cauchy-Binet). For a needle a c - b² would be rounding alone.
    sharp = jnp.sum(jnp.cross(M[0], M[1]) ** 2)
    blurred = sharp + LOW_PASS * (a + c - LOW_PASS)
    opacity = jax.nn.sigmoid(logit)
    if config.antialiased:
        opacity = opacity * jnp.sqrt(jnp.maximum(sharp / blurred, 1e-12))
    # Inverse of the covariance's Cholesky factor [[√a, 0], [b / √a, √(det / a)]].
    whitening = jnp.stack([jnp.stack([zero + 1, zero]), jnp.stack([-b, a]) / jnp.sqrt(blurred)]) / jnp.sqrt(a)
    centre = jnp.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy])
    return centre, whitening, opacity, _colour(sh, offset), z, _slope(M, axes[2], z), drawn


def _slope(M: Float[Array, "2 3"], along_z: Float[Array, "3"], z: Float[Array, ""]) -> Float[Array, "2"]:
    """Slope of inverse depth: its regression on the pixel, limited as in `_surface_depth.py`."""
    u, v = M
    normal = jnp.cross(u, v)
    blurred = normal @ normal + SOFTENING * (u @ u + v @ v + SOFTENING)
    by_image = jnp.stack([jnp.cross(along_z, v) @ normal, jnp.cross(u, along_z) @ normal])
    slope = -(by_image + SOFTENING * M @ along_z) / (blurred * z**2)
    covariance = M @ M.T + LOW_PASS * jnp.eye(2, dtype=z.dtype)
    # The image reaches to where the exponential falls to 1/255.
    change = slope @ covariance @ slope * 2 * jnp.log(1 / MIN_ALPHA)
    limit = jnp.minimum(0.5 / z, FARTHEST * jnp.sqrt(along_z @ along_z) / z**2) ** 2
    return slope * jnp.sqrt(jnp.where(change > limit, limit / jnp.where(change > limit, change, 1), 1))


def _rotation(quaternion: Float[Array, "4"]) -> Float[Array, "3 3"]:
    w, x, y, z = quaternion / jnp.linalg.norm(quaternion)
    vector = jnp.stack([x, y, z])
    zero = jnp.zeros_like(x)
    cross = jnp.stack([jnp.stack([zero, -z, y]), jnp.stack([z, zero, -x]), jnp.stack([-y, x, zero])])
    # Rodrigues: (w² - |v|²) I + 2 v vᵀ + 2 w [v]x.
    return (
        (w * w - vector @ vector) * jnp.eye(3, dtype=x.dtype) + 2 * jnp.outer(vector, vector) + 2 * w * cross
    )


def _colour(sh: Float[Array, "k 3"], offset: Float[Array, "3"]) -> Float[Array, "3"]:
    """0.5 + the sum of the harmonics, not below 0; the constants as 3DGS prints them."""
    x, y, z = offset / jnp.linalg.norm(offset)
    xx, yy, zz = x * x, y * y, z * z
    basis = [
        0.28209479177387814 * jnp.ones_like(x),
        -0.4886025119029199 * y,
        0.4886025119029199 * z,
        -0.4886025119029199 * x,
        1.0925484305920792 * x * y,
        -1.0925484305920792 * y * z,
        0.31539156525252005 * (2 * zz - xx - yy),
        -1.0925484305920792 * x * z,
        0.5462742152960396 * (xx - yy),
        -0.5900435899266435 * y * (3 * xx - yy),
        2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (4 * zz - xx - yy),
        0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
        -0.4570457994644658 * x * (4 * zz - xx - yy),
        1.445305721320277 * z * (xx - yy),
        -0.5900435899266435 * x * (xx - 3 * yy),
    ]
    return jnp.maximum(0.5 + jnp.stack(basis[: sh.shape[0]]) @ sh, 0)
