"""Derivatives of the aligned pose against finite differences of the whole alignment, in float64."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.geometry import Camera, se3
from sfgs_jax.gicp import (
    GicpConfig,
    MotionPrior,
    PointsConfig,
    align,
    prepare,
    prepare_gaussians,
    prepare_points,
)
from tests.gicp.scenes import cast
from tests.gicp.test_point_clouds import MOTION, moved, room

# Steps down to rounding, so that a difference of two alignments is that of two optima.
CONFIG = GicpConfig(levels=1, strides=(1,), max_iterations=(60,), tolerance=(1e-13,), damping=1e-12)
POINTS = PointsConfig(levels=1, voxel_size=0.15, max_points=512, slots=64, doublings=0)
CAMERA = Camera(75.0, 75.0, 39.5, 29.5, width=80, height=60)


def compare(motion, inputs: tuple, rng, *, step: float) -> None:
    """Rate along a random direction by the derivatives and by central differences.

    In reverse mode, which is the transpose of the forward one.
    """

    @jax.jit
    def pose_and_gradients(*inputs):
        pose, pull = jax.vjp(motion, *inputs)
        return pose, jax.vmap(pull)(jnp.eye(len(pose)))

    rates = [rng.normal(size=x.shape) for x in inputs]
    _, gradients = pose_and_gradients(*inputs)
    found = sum(np.tensordot(g, r, axes=r.ndim) for g, r in zip(gradients, rates, strict=True))
    up, down = (
        np.asarray(pose_and_gradients(*(x + s * step * r for x, r in zip(inputs, rates, strict=True)))[0])
        for s in (1, -1)
    )
    expected = (up - down) / (2 * step)
    assert np.abs(expected).max() > 1e-4
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5 * np.abs(expected).max())


def test_with_respect_to_depth(float64, rng):
    motion = np.asarray(se3.matrix(se3.exp(jnp.asarray([0.02, -0.01, 0.02, 0.01, -0.02, 0.01]))))
    noise = rng.normal(scale=0.002, size=(2, *CAMERA.shape))
    target, source = (
        jnp.asarray(cast(CAMERA, T), jnp.float64) + n for T, n in zip((None, motion), noise, strict=True)
    )

    camera = Camera(*jnp.asarray([75.0, 75.0, 39.5, 29.5]), width=80, height=60)

    def pose(source, target):
        source, target = (prepare(x, camera, config=CONFIG) for x in (source, target))
        start = se3.from_matrix(motion, jnp.float64)
        return align(source, target, start, config=CONFIG).T_target_source.wxyz_xyz

    compare(pose, (source, target), rng, step=1e-8)


def test_with_respect_to_points_and_a_prior(float64, rng):
    target, source = jnp.asarray(room(rng, 1500)), jnp.asarray(moved(room(rng, 1500), MOTION))
    information = jnp.diag(jnp.asarray([1e5, 1e5, 1e5, 1e4, 1e4, 1e4]))

    def pose(source, target, mean):
        source, target = (prepare_points(x, config=POINTS) for x in (source, target))
        prior = MotionPrior(se3.exp(mean), information)
        start = se3.from_matrix(MOTION, jnp.float64)
        return align(source, target, start, prior=prior, config=CONFIG).T_target_source.wxyz_xyz

    compare(pose, (source, target, se3.log(se3.from_matrix(MOTION, jnp.float64))), rng, step=1e-8)


def test_with_respect_to_a_map_s_covariances(float64, rng):
    points = room(rng, 1500)
    source = prepare_points(jnp.asarray(moved(room(rng, 1500), MOTION)), config=POINTS)
    spread = rng.normal(size=(len(points), 3, 3)) * np.asarray([1, 1, 0.3])
    covariances = jnp.asarray(1e-4 * (spread @ spread.transpose(0, 2, 1)))

    def pose(means, covariances):
        covariances = (covariances + covariances.transpose(0, 2, 1)) / 2
        target = prepare_gaussians(means, covariances, target_covariance="map", config=POINTS)
        start = se3.from_matrix(MOTION, jnp.float64)
        return align(source, target, start, config=CONFIG).T_target_source.wxyz_xyz

    compare(pose, (jnp.asarray(points), covariances), rng, step=1e-10)


@jax.jit
@jax.grad
def slope_of_an_alignment_with_itself(depth):
    flat = GicpConfig(levels=1, strides=(1,), max_iterations=(8,))
    cloud = prepare(depth, CAMERA, config=flat)
    result = align(cloud, cloud, se3.identity(), config=flat)
    return jnp.sum(result.T_target_source.wxyz_xyz**2) + jnp.trace(result.information)


@pytest.mark.parametrize("metres", [2.0, 0.0], ids=["wall", "nothing"])
def test_degenerate_input_has_finite_gradients(metres):
    depth = np.full(CAMERA.shape, metres, np.float32)
    assert np.all(np.isfinite(slope_of_an_alignment_with_itself(depth)))


def test_empty_clouds_have_finite_gradients():
    @jax.jit
    @jax.grad
    def slope(points):
        cloud = prepare_points(points, config=POINTS)
        return jnp.sum(align(cloud, cloud, se3.identity()).T_target_source.wxyz_xyz ** 2)

    assert np.all(np.isfinite(slope(jnp.zeros((20, 3)))))
