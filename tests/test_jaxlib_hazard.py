"""Functions that map over rows, at sizes where a jaxlib computed rows wrongly.

On CPUs, jaxlib 0.10.2 returns wrong numbers in every row from the 32769th on (jax#39103). It does so for
32769 to about 41,000 rows that are each multiplied by a shared 3 x 3 matrix, squared and summed. A map of
Gaussians has that many rows. The first test is that pattern and fails on an affected jaxlib; the others test
this library.
"""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest
from scipy.spatial import KDTree

from sfgs_jax import factor_graph, gicp, splatting
from sfgs_jax.geometry import Camera, se3

SIZES = (32768, 32769, 36864, 40001, 40960)
EVEN = 40960
"""An affected size whose halves are not."""
CAMERA = Camera(200.0, 200.0, 99.5, 74.5, width=200, height=150)
T = se3.exp(jnp.asarray([0.3, -0.2, 0.1, 0.2, -0.1, 0.3]))
DEFAULTS: dict[str, str | bool] = {"xla_backend_optimization_level": "3", "xla_cpu_use_fusion_emitters": True}
"""XLA's defaults, in place of what `make test` sets: this is about programs as users compile them."""

compiled = partial(jax.jit, compiler_options=DEFAULTS)


def normal(rng, *shape: int) -> jax.Array:
    return jnp.asarray(rng.normal(size=shape), jnp.float32)


def in_halves(function: Callable, rows: jax.Array) -> list[np.ndarray]:
    """Results by row, axis 0, of each half of the rows by itself, put together again."""
    halves = [jax.tree.leaves(function(half)) for half in jnp.split(rows, 2)]
    return [np.concatenate(pair) for pair in zip(*halves, strict=True)]


def assert_halves_agree(function: Callable, rows: jax.Array) -> None:
    """Rows computed together are those computed in two halves, to rounding."""
    program = compiled(function)
    for whole, halves in zip(jax.tree.leaves(program(rows)), in_halves(program, rows), strict=True):
        assert len(whole) == EVEN
        np.testing.assert_allclose(whole, halves, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("n", SIZES)
def test_squared_lengths_of_products_are_right(rng, n):
    M, rows = normal(rng, 3, 3), normal(rng, n, 3)
    found = compiled(jax.vmap(lambda r: jnp.sum((M @ r) ** 2)))(rows)
    expected = np.sum((np.asarray(rows, np.float64) @ np.asarray(M, np.float64).T) ** 2, axis=1)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("n", SIZES)
def test_transformed_points_are_right(rng, n):
    points, matrix = normal(rng, n, 3), se3.to_matrices(jaxlie.SE3(T.wxyz_xyz[None]))[0]
    expected = np.asarray(points, np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    np.testing.assert_allclose(compiled(se3.transform)(T, points), expected, atol=1e-5)
    squares = compiled(jax.vmap(lambda p: jnp.sum(se3.transform(T, p) ** 2)))(points)
    np.testing.assert_allclose(squares, np.sum(expected**2, axis=1), rtol=1e-4)


def test_projected_gaussians_are_right(rng):
    def project(means: jax.Array) -> tuple[jax.Array, ...]:
        n = len(means)
        gaussians = splatting.Gaussians(
            means=means,
            quaternions=jnp.tile(jnp.asarray([0.9, 0.1, -0.2, 0.3], jnp.float32), (n, 1)),
            log_scales=jnp.tile(jnp.asarray([-3.0, -3.5, -4.0], jnp.float32), (n, 1)),
            opacity_logits=jnp.zeros(n),
            sh=jnp.zeros((n, 1, 3)),
            valid=jnp.ones(n, bool),
        )
        projected, _ = splatting.project(gaussians, CAMERA, T)
        return tuple(x for x in jax.tree.leaves(projected) if x.shape[:1] == (n,))

    means = normal(rng, EVEN, 3) + jnp.asarray([[0.0, 0.0, 5.0]])
    assert_halves_agree(project, means)


def test_residuals_of_observations_are_right(rng):
    values = factor_graph.Values(jaxlie.SE3(T.wxyz_xyz[None]), normal(rng, 50, 3) + 3)
    index = np.arange(EVEN) % 50

    def residuals(pixels: jax.Array) -> jax.Array:
        n = len(pixels)
        factor = factor_graph.Reprojection(np.zeros(n, np.int32), index[:n], pixels, CAMERA)
        return factor.residuals(values)[0].T

    pixels = normal(rng, EVEN, 2)
    whole = compiled(residuals)(pixels)
    points = se3.transform(se3.inverse(T), values.landmarks)
    np.testing.assert_allclose(whole, (CAMERA.project(points)[index] - pixels), rtol=1e-4, atol=1e-2)


def test_residuals_between_poses_are_right(rng):
    motions = se3.exp(0.3 * normal(rng, EVEN, 6)).wxyz_xyz
    values = factor_graph.Values(jaxlie.SE3(jnp.stack([se3.identity().wxyz_xyz, T.wxyz_xyz])))

    def residuals(motions: jax.Array) -> jax.Array:
        poses = np.tile(np.asarray([[0, 1]], np.int32), (len(motions), 1))
        return factor_graph.RelativePose(poses, jaxlie.SE3(motions), jnp.eye(6)).residuals(values)[0].T

    assert_halves_agree(residuals, motions)


def test_clouds_of_points_have_the_right_normals_and_align(rng):
    """Points of a gently waved sheet, one a voxel, in a shuffled order; the motion is small and known."""
    x, y = np.meshgrid(np.arange(-100, 100) / 100, np.arange(-100, 101) / 100)
    z = 0.1 * np.sin(3 * x) * np.cos(2 * y)
    slopes = -0.3 * np.cos(3 * x) * np.cos(2 * y), 0.2 * np.sin(3 * x) * np.sin(2 * y), np.ones_like(x)
    points = np.stack([x + 0.005, y + 0.005, z], -1).reshape(-1, 3).astype(np.float32)
    normals = np.stack(slopes, -1).reshape(-1, 3)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    order = rng.permutation(len(points))
    config = gicp.PointsConfig(levels=1, voxel_size=0.01, max_points=40960, slots=32, doublings=0)
    cloud = gicp.prepare_points(points[order], k=9, config=config)
    level = cloud.levels[0]
    valid = np.asarray(level.valid)
    assert 38_000 < valid.sum() <= len(points)
    places = np.asarray(level.points)[valid] + np.asarray(cloud.origin)
    distance, index = KDTree(points).query(places)
    assert distance.max() < 0.01
    cosine = np.abs(np.sum(normals[index] * np.asarray(level.normals)[valid], axis=1))
    assert cosine.min() > 0.99
    motion = se3.exp(jnp.asarray([0.002, -0.001, 0.001, 0.001, 0.002, -0.001]))
    moved = np.asarray(se3.transform(motion, jnp.asarray(points[order])))
    target = gicp.prepare_points(moved, k=9, config=config)
    result = compiled(partial(gicp.align, config=gicp.GicpConfig(levels=1)))(cloud, target, se3.identity())
    metres, radians = se3.extent(se3.compose(se3.inverse(motion), result.T_target_source))
    assert metres < 2e-4
    assert radians < 2e-4
    assert result.inlier_fraction > 0.99
