"""The conventions that 3D Gaussian Splatting and gsplat document, from a few lines of NumPy and SciPy."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import sph_harm_y

from sfgs_jax.geometry import Camera, se3
from sfgs_jax.splatting import Gaussians, RenderConfig, project, render

WIDTH, HEIGHT, FOCAL = 24, 16, 30.0
CX, CY = 12.3, 8.4  # with pixel centres at +0.5, as those renderers have them
MEANS = np.asarray([[0.05, -0.1, 2.0], [0.0, 0.05, 2.5], [0.1, 0.0, 3.0], [-0.3, 0.2, 3.5]])
SCALES = np.asarray([[0.2, 0.05, 0.1], [0.3, 0.2, 0.01], [0.02, 0.02, 0.02], [3.0, 2.0, 1.0]])
QUATERNIONS = np.asarray([[0.9, 0.1, -0.3, 0.2], [0.5, 0.5, 0.1, -0.2], [1, 0, 0, 0], [0.3, -0.2, 0.8, 0.1]])
OPACITIES = np.asarray([0.4, 0.9, 0.7, 0.999])
COLOURS = np.asarray([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0.5]])


def drawn(antialiased: bool):
    scene = Gaussians(
        *(jnp.asarray(x, jnp.float32) for x in (MEANS, QUATERNIONS, np.log(SCALES))),
        opacity_logits=jnp.asarray(np.log(OPACITIES / (1 - OPACITIES)), jnp.float32),
        sh=jnp.zeros((4, 1, 3)),
        valid=jnp.ones(4, bool),
    )
    camera = Camera(FOCAL, FOCAL, CX - 0.5, CY - 0.5, width=WIDTH, height=HEIGHT)
    config = RenderConfig(pair_capacity=1024, antialiased=antialiased)
    return render(scene, camera, se3.identity(), None, jnp.asarray(COLOURS, jnp.float32), config=config)


def covariance(i: int) -> np.ndarray:
    w, x, y, z = QUATERNIONS[i] / np.linalg.norm(QUATERNIONS[i])
    R = np.asarray(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return R @ np.diag(SCALES[i] ** 2) @ R.T


@pytest.mark.parametrize("antialiased", [False, True])
def test_pixels_are_those_of_the_published_equations(antialiased):
    u, v = np.arange(WIDTH) + 0.5, np.arange(HEIGHT)[:, None] + 0.5
    light, image = np.ones((HEIGHT, WIDTH)), np.zeros((HEIGHT, WIDTH, 3))
    capped, skipped = 0, 0
    for i, (x, y, z) in enumerate(MEANS):  # nearest first
        J = np.asarray([[FOCAL / z, 0, -FOCAL * x / z**2], [0, FOCAL / z, -FOCAL * y / z**2]])
        sharp = J @ covariance(i) @ J.T
        blurred = sharp + 0.3 * np.eye(2)
        compensation = np.sqrt(np.linalg.det(sharp) / np.linalg.det(blurred)) if antialiased else 1.0
        (a, b), (_, c) = np.linalg.inv(blurred)
        du, dv = u - (FOCAL * x / z + CX), v - (FOCAL * y / z + CY)
        exponent = 0.5 * (a * du**2 + c * dv**2) + b * du * dv
        alpha = np.minimum(0.99, OPACITIES[i] * compensation * np.exp(-exponent))
        capped, skipped = capped + np.sum(alpha == 0.99), skipped + np.sum(alpha < 1 / 255)
        alpha[alpha < 1 / 255] = 0
        image += (light * alpha)[..., None] * COLOURS[i]
        light *= 1 - alpha
    assert light.min() > 1e-4  # no pixel ends early here
    assert skipped
    assert capped
    out = drawn(antialiased)
    np.testing.assert_allclose(out.rgb, image, atol=2e-6)
    np.testing.assert_allclose(out.alpha, 1 - light, atol=2e-6)


def test_harmonics_have_the_order_and_signs_of_ply_files():
    """Coefficient l² + l + m belongs to degree l and order m, with the Condon-Shortley phase."""
    direction = np.asarray([0.36, -0.48, 0.8])
    polar, azimuth = np.arccos(direction[2]), np.arctan2(direction[1], direction[0])
    expected = []
    for degree in range(4):
        for order in range(-degree, degree + 1):
            value = sph_harm_y(degree, abs(order), polar, azimuth)
            root = np.sqrt(2) if order else 1.0
            expected.append(root * (value.imag if order < 0 else value.real))
    # One Gaussian for each coefficient, all in the same direction.
    scene = Gaussians(
        means=jnp.asarray(np.tile(2 * direction, (16, 1)), jnp.float32),
        quaternions=jnp.ones((16, 4)),
        log_scales=jnp.full((16, 3), -3.0),
        opacity_logits=jnp.zeros(16),
        sh=0.5 * jnp.eye(16)[:, :, None] * jnp.ones((1, 1, 3)),
        valid=jnp.ones(16, bool),
    )
    camera = Camera(FOCAL, FOCAL, CX, CY, width=WIDTH, height=HEIGHT)
    rgb = project(scene, camera, se3.identity())[1]
    np.testing.assert_allclose(rgb[:, 0], 0.5 + 0.5 * np.asarray(expected), atol=1e-6)
