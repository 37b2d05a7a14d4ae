"""Render Gaussians, and fit them to an image by gradient descent.

The Gaussians start on the depth image of one frame, all of them grey. Adam then fits every parameter to the
frame's colours. A second frame, which takes no part in the fit, shows that the scene itself got better.

    python examples/00_render_and_fit.py [PICTURE.png]
"""

import sys

import cv2
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax

from sfgs_jax import datasets, splatting
from sfgs_jax.evaluation import psnr
from sfgs_jax.geometry import se3, surface


def main(
    width: int = 160, height: int = 120, steps: int = 100, picture: str | None = None
) -> dict[str, float]:
    recording = datasets.SyntheticRecording(num_frames=60, width=width, height=height)
    camera, poses = recording.camera, recording.ground_truth.poses
    fitted, held_out = recording[0], recording[2]

    # One Gaussian for each pixel that has a surface, as wide as the pixel is there.
    found = surface(fitted.depth, camera)
    means = found.points.reshape(-1, 3)
    scales = jnp.log(jnp.maximum(means[:, 2:], 0.1) / camera.fx)
    gaussians = splatting.Gaussians(
        means=se3.transform(se3.from_matrix(poses[0]), means),
        quaternions=jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (len(means), 1)),
        log_scales=jnp.tile(scales, (1, 3)),
        opacity_logits=jnp.full(len(means), 2.0, jnp.float32),
        sh=splatting.rgb_to_sh(jnp.full((len(means), 1, 3), 0.5, jnp.float32)),
        valid=found.valid.reshape(-1),
    )
    views = [(jnp.asarray(frame.rgb), se3.from_matrix(poses[i])) for i, frame in ((0, fitted), (2, held_out))]
    room = max(splatting.pair_capacity(gaussians, camera, T, headroom=1.5) for _, T in views)
    config = splatting.RenderConfig(pair_capacity=room)

    def drawn(gaussians):
        return [splatting.render(gaussians, camera, T, config=config).rgb for _, T in views]

    optimiser = optax.adam(1e-2)

    @jax.jit
    def step(gaussians, moments):
        def loss(gaussians):
            rgb, T_world_cam = views[0]
            return splatting.l1(splatting.render(gaussians, camera, T_world_cam, config=config).rgb, rgb)

        gradients = eqx.filter_grad(loss)(gaussians)  # of the floats; `valid` has none
        updates, moments = optimiser.update(gradients, moments)
        return eqx.apply_updates(gaussians, updates), moments

    first = drawn(gaussians)
    moments = optimiser.init(eqx.filter(gaussians, eqx.is_inexact_array))
    for _ in range(steps):
        gaussians, moments = step(gaussians, moments)
    last = drawn(gaussians)
    before, after = (
        [float(psnr(a, rgb)) for a, (rgb, _) in zip(n, views, strict=True)] for n in (first, last)
    )
    if picture is not None:
        save(picture, [[a, b, rgb] for a, b, (rgb, _) in zip(first, last, views, strict=True)])
    print(f"{int(gaussians.valid.sum())} Gaussians, {steps} steps")
    print(f"fitted view:   {before[0]:.1f} dB before, {after[0]:.1f} dB after")
    print(f"held-out view: {before[1]:.1f} dB before, {after[1]:.1f} dB after")
    return {
        "fitted_before": before[0],
        "fitted_after": after[0],
        "held_out_before": before[1],
        "held_out_after": after[1],
    }


def save(path, rows):
    """A row for each view: before, after, and the frame itself."""
    image = np.clip(np.concatenate([np.concatenate(row, axis=1) for row in rows]), 0, 1)
    cv2.imwrite(path, np.round(255 * image[..., ::-1]).astype(np.uint8))


if __name__ == "__main__":
    main(picture=sys.argv[1] if len(sys.argv) > 1 else None)
