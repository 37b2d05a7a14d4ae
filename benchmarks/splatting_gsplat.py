"""Images and gradients beside gsplat's, in float64, without a GPU.

    python -m benchmarks.splatting_gsplat

gsplat has a PyTorch implementation of everything but the loop over a pixel's Gaussians, which only its CUDA
kernel has. So covariances, projection, low-pass filter, compensation and spherical harmonics are gsplat's own
here. The loop is written out densely with the kernel's rules. Opacity is at most 0.999 (0.99 in this
library), contributions below 1/255 are skipped, and a pixel ends before less than 1e-4 of the light is left.

Scenes are real surfaces with random colours that depend on the direction, and random Gaussians of every size,
shape and place.
"""

import jax
import jax.numpy as jnp
import numpy as np
import torch  # pyright: ignore[reportMissingImports]
from gsplat.cuda._torch_impl import (  # pyright: ignore[reportMissingImports]
    _fully_fused_projection,
    _quat_scale_to_covar_preci,
    _spherical_harmonics,
)

from benchmarks.splatting import converted, load_view
from sfgs_jax.geometry import Camera, se3
from sfgs_jax.splatting import GAUSSIAN_PARAMETERS, Gaussians, RenderConfig, pair_capacity, render
from tests.splatting.scenes import make_camera, make_pose, make_scene


def gsplat_images(
    p: dict[str, torch.Tensor], camera: Camera, world_to_camera: torch.Tensor, antialiased: bool
) -> tuple[torch.Tensor, torch.Tensor]:
    """(H, W, 4) colour and accumulated depth, and (H, W) opacity."""
    # gsplat's pixel centres lie at one half.
    fx, fy, cx, cy = (float(x) for x in (camera.fx, camera.fy, camera.cx, camera.cy))
    K = torch.tensor([[fx, 0, cx + 0.5], [0, fy, cy + 0.5], [0, 0, 1]], dtype=torch.float64)
    covariances, _ = _quat_scale_to_covar_preci(p["quaternions"], p["log_scales"].exp(), True, False)
    assert covariances is not None
    radii, means, depths, conics, compensations = _fully_fused_projection(
        p["means"],
        covariances,
        world_to_camera[None],
        K[None],
        camera.width,
        camera.height,
        near_plane=RenderConfig().near,
        far_plane=RenderConfig().far,
        calc_compensations=antialiased,
    )
    opacities = p["opacity_logits"].sigmoid()
    if compensations is not None:
        opacities = opacities * compensations[0]
    eye = torch.linalg.inv(world_to_camera)[:3, 3]
    degree = int(p["sh"].shape[1] ** 0.5) - 1
    colours = (_spherical_harmonics(degree, p["means"] - eye, p["sh"]) + 0.5).clamp(min=0)
    columns = torch.cat([colours, depths[0][:, None]], dim=1)

    order = torch.argsort(depths[0])
    order = order[(radii[0, order] > 0).all(dim=1)]
    v, u = torch.meshgrid(
        torch.arange(camera.height, dtype=torch.float64) + 0.5,
        torch.arange(camera.width, dtype=torch.float64) + 0.5,
        indexing="ij",
    )
    light = torch.ones_like(u)
    images, going = torch.zeros((*u.shape, 4), dtype=torch.float64), torch.ones_like(u, dtype=torch.bool)
    for i in order.tolist():
        dx, dy = means[0, i, 0] - u, means[0, i, 1] - v
        a, b, c = conics[0, i]
        alpha = (opacities[i] * torch.exp(-(a * dx * dx + c * dy * dy) / 2 - b * dx * dy)).clamp(max=0.999)
        alpha = torch.where(alpha < 1 / 255, 0, alpha)
        left = light * (1 - alpha)
        going = going & (left > 1e-4)
        images = images + torch.where(going, light * alpha, 0)[..., None] * columns[i]
        light = torch.where(going, left, light)
    return images, 1 - light


def compare(name: str, scene: Gaussians, camera: Camera, T_world_cam, antialiased: bool) -> None:
    """Print the relative errors of the images and of every gradient, and the angles between these."""
    with jax.enable_x64(True):
        scene, camera, T_world_cam = converted((scene, camera, T_world_cam), jnp.float64)
        config = RenderConfig(
            pair_capacity=pair_capacity(scene, camera, T_world_cam), antialiased=antialiased
        )
        world_to_camera = torch.tensor(np.asarray(se3.matrix(se3.inverse(T_world_cam))))
        weights = np.random.default_rng(0).normal(size=(*camera.shape, 5))

        def loss(scene: Gaussians):
            out = render(scene, camera, T_world_cam, config=config)
            images = jnp.concatenate([out.rgb, out.accumulated_depth[..., None], out.alpha[..., None]], -1)
            return jnp.sum(jnp.asarray(weights) * images), images

        (_, ours), gradients = jax.jit(jax.value_and_grad(loss, has_aux=True, allow_int=True))(scene)
    kept = np.flatnonzero(np.asarray(scene.valid))
    p = {
        n: torch.tensor(np.asarray(getattr(scene, n))[kept], dtype=torch.float64, requires_grad=True)
        for n in GAUSSIAN_PARAMETERS
    }
    colours, alpha = gsplat_images(p, camera, world_to_camera, antialiased)
    theirs = torch.cat([colours, alpha[..., None]], dim=-1)
    (theirs * torch.tensor(weights)).sum().backward()

    def off(a: np.ndarray, b: np.ndarray) -> str:
        cosine = np.vdot(a, b) / np.linalg.norm(a) / np.linalg.norm(b)
        return f"{np.linalg.norm(a - b) / np.linalg.norm(b):.1e} ({1 - cosine:.0e})"

    cells = [off(np.asarray(ours), theirs.detach().numpy())]
    for n in GAUSSIAN_PARAMETERS:
        gradient = p[n].grad
        assert gradient is not None
        cells.append(off(np.asarray(getattr(gradients, n))[kept], gradient.numpy()))
    print("| " + " | ".join([name, *cells]) + " |", flush=True)


def main() -> None:
    """Print the table."""
    header = ("relative error (1 - cosine)", "images", *GAUSSIAN_PARAMETERS)
    print("| " + " | ".join(header) + " |\n|" + " --- |" * len(header))
    view = load_view()
    small, real = view.smaller(8), view.resampled(1500).shaken().gaussians
    sh = np.random.default_rng(2).normal(0, 0.2, (1500, 16, 3))
    sh[:, :1] = np.asarray(real.sh)
    real = Gaussians(
        real.means,
        real.quaternions,
        real.log_scales,
        real.opacity_logits,
        jnp.asarray(sh, jnp.float32),
        real.valid,
    )
    for antialiased in (False, True):
        mode = "antialiased" if antialiased else "classic"
        compare(f"real, {mode}", real, small.camera, small.T_world_cam, antialiased)
        for seed in (30, 31):
            scene, camera = make_scene(seed, degree=3), make_camera(121, 91)
            compare(f"mixed {seed}, {mode}", scene, camera, make_pose(), antialiased)


if __name__ == "__main__":
    main()
