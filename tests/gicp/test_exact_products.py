"""Results on devices whose default products are TF32, emulated, and a list of products at the default."""

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
    level_problem,
    prepare,
    prepare_gaussians,
    prepare_points,
    rigid_from_matches,
)
from tests.gicp.scenes import cast
from tests.gicp.test_point_clouds import moved, room
from tests.tf32 import at_tf32, default_products

CAMERA = Camera(150.0, 150.0, 79.5, 59.5, width=160, height=120)
MOTION = np.asarray(se3.matrix(se3.exp(jnp.asarray([0.03, -0.02, 0.04, 0.02, -0.03, 0.015]))), np.float64)
CONFIG = GicpConfig(levels=1)
POINTS = PointsConfig(levels=1, max_points=512)
KINDS = ("depth", "points", "map")
METHODS = ("least_squares", "graduated", "ransac")


def clouds(kind: str):
    """Source, and target as the kind says."""
    if kind == "depth":
        return tuple(prepare(cast(CAMERA, T), CAMERA, config=CONFIG) for T in (MOTION, None))
    rng = np.random.default_rng(3)
    points = room(rng, 2000)
    source = prepare_points(moved(points, MOTION), config=POINTS)
    if kind == "points":
        return source, prepare_points(points, config=POINTS)
    covariances = np.broadcast_to(np.diag([1e-4, 2e-4, 3e-4]), (len(points), 3, 3))
    return source, prepare_gaussians(points, covariances, target_covariance="map", config=POINTS)


def registered(source, target):
    """Motion, information, and cost of the normal equations at the start."""
    prior = MotionPrior(se3.from_matrix(MOTION), 1e3 * jnp.eye(6))
    result = align(source, target, se3.identity(), prior=prior, config=CONFIG)
    problem = level_problem(source.levels, target.levels, prior, 0, CONFIG)
    start = se3.exp(jnp.asarray([0.04, -0.02, 0.03, 0.01, -0.03, 0.01]))
    equations = problem.equations(start, problem.correspondences(start))
    return result.T_target_source.wxyz_xyz, result.information, equations.hessian, equations.cost


def difference(found, expected) -> float:
    """Largest difference as a share of the largest entry."""
    return float(np.abs(found - expected).max() / np.abs(expected).max())


@pytest.mark.parametrize("kind", KINDS)
def test_registration_needs_no_more_than_exact_products(kind):
    source, target = clouds(kind)
    expected = jax.jit(registered)(source, target)
    emulated = at_tf32(registered)(source, target)
    rounded = at_tf32(registered, every=True)(source, target)
    assert np.all(np.isfinite(np.concatenate([np.ravel(x) for x in emulated])))
    for name, exact, found, wrong in zip(
        ("motion", "information", "hessian", "cost"), expected, emulated, rounded, strict=True
    ):
        assert difference(found, exact) < 2e-6, name
        assert difference(wrong, exact) > 2e-5, name  # the test would see a product left at the default


@pytest.mark.parametrize("kind", KINDS)
def test_no_product_of_a_registration_is_at_the_default_precision(kind):
    source, target = clouds(kind)
    assert default_products(registered, source, target) == []


def test_no_product_of_a_derivative_is_at_the_default_precision():
    target = clouds("depth")[1]

    def total(depth):
        return jnp.sum(registered(prepare(depth, CAMERA, config=CONFIG), target)[0] ** 2)

    assert default_products(jax.grad(total), jnp.asarray(cast(CAMERA, MOTION))) == []


@pytest.mark.parametrize("method", METHODS)
def test_matched_points_need_no_more_than_exact_products(rng, key, method):
    p = jnp.asarray(rng.uniform(-2, 2, size=(64, 3)), jnp.float32)
    q = se3.transform(se3.from_matrix(MOTION), p) + jnp.asarray(rng.normal(scale=0.003, size=p.shape))

    def motion(p, q):
        return rigid_from_matches(p, q, method=method, key=key).T_target_source.wxyz_xyz

    expected = jax.jit(motion)(p, q)
    assert difference(at_tf32(motion)(p, q), expected) < 2e-6
    assert difference(at_tf32(motion, every=True)(p, q), expected) > 2e-5
    assert default_products(motion, p, q) == []
    assert default_products(jax.grad(lambda p, q: jnp.sum(motion(p, q))), p, q) == []
