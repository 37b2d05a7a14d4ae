"""Every residual's Jacobian against finite differences, and rows that must not matter."""

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest

from sfgs_jax.factor_graph import (
    CustomFactor,
    DirectGicp,
    Factor,
    PosePrior,
    RelativePose,
    Reprojection,
    RgbdReprojection,
    Values,
    retract,
)
from sfgs_jax.geometry import inverse_right_jacobian, se3
from tests.factor_graph.graphs import CAMERA, dtype, random_poses

KINDS = ("prior", "relative", "pixels", "rgbd", "gicp", "custom")


# One program for each instead of one for each operation.
terms_of = jax.jit(lambda factor, values: factor.terms(values))
linearised = jax.jit(lambda factor, values: factor.linearise(values))
residuals_of = jax.jit(lambda factor, values: factor.residuals(values)[0])


def range_to(row, poses, landmark):
    return (jnp.linalg.norm(landmark - poses.wxyz_xyz[0, 4:]) - row)[None]


def spd(rng, n: int, size: int):
    root = rng.normal(size=(n, size, size))
    return jnp.asarray(root @ root.transpose(0, 2, 1) + np.eye(size), dtype())


def block(kind: str, rng, n: int = 5, **options):
    """Values of three poses and four landmarks, and a block of n factors on them."""
    values = Values(random_poses(rng, 3), jnp.asarray(rng.uniform([-1, -1, 2], [1, 1, 4], (4, 3)), dtype()))
    one, other = rng.integers(0, 3, n), rng.integers(0, 4, n)
    two = np.stack([one, (one + 1) % 3], axis=1)
    pixels = jnp.asarray(rng.uniform(0, 480, (n, 2)), dtype())
    match kind:
        case "prior":
            return values, PosePrior(one, random_poses(rng, n), spd(rng, n, 6), **options)
        case "relative":
            return values, RelativePose(two, random_poses(rng, n, 1.0), spd(rng, n, 6), **options)
        case "pixels":
            return values, Reprojection(one, other, pixels, CAMERA, sigma=2.0, **options)
        case "rgbd":
            depth = jnp.asarray(rng.uniform(2, 4, n), dtype()).at[1].set(0)
            return values, RgbdReprojection(one, other, pixels, depth, CAMERA, sigma=2.0, **options)
        case "gicp":
            source, target = (jnp.asarray(rng.normal(size=(n, 3)), dtype()) for _ in range(2))
            pair = rng.integers(0, 2, n)
            return values, DirectGicp(
                [[0, 1], [1, 2]], source, target, pair=pair, information=spd(rng, n, 3), **options
            )
        case _:
            rows = jnp.asarray(rng.uniform(1, 3, n), dtype())
            return values, CustomFactor(range_to, one, rows, landmarks=other, **options)


@pytest.mark.parametrize("kind", KINDS)
def test_jacobians_are_those_of_finite_differences(float64, rng, kind):
    values, factor = block(kind, rng)
    linear, step = linearised(factor, values), 1e-6
    residuals = jax.jit(lambda poses, landmarks: factor.residuals(retract(values, poses, landmarks))[0])
    np.testing.assert_allclose(linear.residual, residuals_of(factor, values), atol=1e-12)

    def slopes(shape, ahead):
        """(R, *shape, N): each coordinate of each variable moved in turn."""
        columns = []
        for unit in np.eye(shape[0] * shape[1]).reshape(-1, *shape):
            columns.append((ahead(step * unit) - ahead(-step * unit)) / (2 * step))
        return np.stack(columns, axis=1).reshape(-1, *shape, len(factor.valid))

    by_pose = slopes((3, 6), lambda x: residuals(x, np.zeros((4, 3))))
    by_landmark = slopes((4, 3), lambda x: residuals(np.zeros((3, 6)), x))
    for row, poses in enumerate(factor.poses):
        expected = np.concatenate([by_pose[:, pose, :, row] for pose in poses], axis=1)
        np.testing.assert_allclose(linear.pose_jacobian[..., row], expected, rtol=1e-5, atol=1e-5)
        if factor.landmarks is not None:
            expected = by_landmark[:, factor.landmarks[row], :, row]
            np.testing.assert_allclose(linear.landmark_jacobian[..., row], expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_closed_forms_are_those_of_the_row_function(float64, rng, kind):
    """`residual`, `residuals` and the generic `linearise` say the same as the fast versions."""
    values, factor = block(kind, rng)

    @jax.jit
    def by_row(factor, values):
        rows, (poses, landmarks) = factor.clean_measurements(), factor.gather(values)
        residual = jax.vmap(factor.residual, out_axes=-1)(rows, poses, landmarks)
        return residual, Factor.linearise(factor, values)

    residual, generic = by_row(factor, values)
    fast = linearised(factor, values)
    np.testing.assert_allclose(residuals_of(factor, values), residual, atol=1e-10)
    np.testing.assert_allclose(fast.residual, generic.residual, atol=1e-10)
    np.testing.assert_allclose(fast.pose_jacobian, generic.pose_jacobian, atol=1e-8)
    if factor.landmarks is not None:
        np.testing.assert_allclose(fast.landmark_jacobian, generic.landmark_jacobian, atol=1e-8)


@pytest.mark.parametrize("kind", KINDS)
def test_terms_are_the_products_of_the_jacobians(float64, rng, kind):
    values, factor = block(kind, rng, kernel="cauchy", kernel_width=1.5)
    linear, terms = linearised(factor, values), terms_of(factor, values)
    gradient = np.zeros((3, 6))

    @jax.jit
    @jax.grad
    def slope(steps):
        return jnp.sum(factor.losses(retract(values, steps, jnp.zeros((4, 3))))) / 2

    groups = np.asarray(factor.groups)
    np.add.at(gradient, groups.reshape(-1), np.asarray(terms.pose_gradient).reshape(-1, 6))
    np.testing.assert_allclose(gradient, slope(jnp.zeros((3, 6))), rtol=1e-8, atol=1e-8)
    assert linear.residual.shape[1] == len(terms.losses)
    hessian = np.asarray(terms.pose_hessian)
    np.testing.assert_allclose(hessian, hessian.swapaxes(1, 2), atol=1e-6)
    assert np.linalg.eigvalsh(hessian).min() > -1e-6


@pytest.mark.parametrize("kind", KINDS)
def test_what_masked_rows_hold_does_not_matter(rng, kind):
    mask = np.array([True, False, True, True, False])
    values, factor = block(kind, rng, valid=mask)

    def poison(x):
        if not isinstance(x, jax.Array) or x.ndim == 0 or x.shape[0] != 5:
            return x
        lanes = jnp.asarray(mask).reshape(-1, *[1] * (x.ndim - 1))
        return jnp.where(lanes, x, jnp.nan)

    poisoned = jax.tree.map(poison, factor)
    clean, dirty = terms_of(factor, values), terms_of(poisoned, values)
    for a, b in zip(jax.tree.leaves(clean), jax.tree.leaves(dirty), strict=True):
        np.testing.assert_array_equal(a, b)
        assert np.all(np.isfinite(b))

    @jax.jit
    @jax.grad
    def slope(poses):
        return jnp.sum(poisoned.losses(Values(jaxlie.SE3(poses), values.landmarks)))

    assert np.all(np.isfinite(slope(values.poses.wxyz_xyz)))


def test_a_landmark_behind_the_camera_costs_and_does_not_pull(rng):
    values = Values(se3.exp(jnp.zeros((1, 6))), jnp.asarray([[0.1, 0.2, -1.0], [0, 0, 0], [0, 0, 2]]))
    factor = Reprojection([0, 0, 0], [0, 1, 2], jnp.asarray([[1.0, 2]] * 3), CAMERA)
    terms = terms_of(factor, values)
    np.testing.assert_allclose(terms.losses[:2], 2 * 640.0**2)
    assert not np.any(terms.pose_gradient[:2])
    assert not np.any(terms.landmark_hessian[:2])
    assert np.any(terms.landmark_hessian[2])
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(terms))


def test_the_derivative_of_the_logarithm_is_accurate_in_float32():
    angles = np.array([0.0, 1e-6, 1e-3, 0.1, 0.99, 1.01, 2.0, 3.0])
    axis = np.array([0.6, -0.64, 0.48])
    tangents = np.concatenate([np.tile([0.3, -0.5, 0.2], (8, 1)), angles[:, None] * axis], axis=1)
    found = jax.jit(inverse_right_jacobian)(tangents.T.astype(np.float32))
    with jax.enable_x64(True):

        def changed(tangent, step):
            return se3.log(se3.compose(se3.exp(tangent), se3.exp(step)))

        slopes = jax.jit(jax.vmap(jax.jacfwd(changed, argnums=1), (0, None), -1))
        expected = slopes(tangents, np.full(6, 1e-9))
    np.testing.assert_allclose(found, expected, atol=3e-6)
