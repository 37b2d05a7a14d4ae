"""Rigid motion from matched points: against SciPy, with wrong matches, with too few, and its derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sfgs_jax.arrays import InputError
from sfgs_jax.geometry import se3
from sfgs_jax.gicp import rigid_from_matches
from tests.gicp.scenes import motion_error

COUNT = 300
"""Matches of a list, wherever their number doesn't matter: each size is a program of its own."""


def matched(rng, n: int = COUNT, *, wrong: float = 0.0, noise: float = 0.005) -> tuple[np.ndarray, ...]:
    """Source and target (n, 3) float32, the motion between them, and which matches are right."""
    T = np.eye(4)
    T[:3, :3] = Rotation.random(None, rng).as_matrix()
    T[:3, 3] = rng.normal(size=3)
    p = rng.uniform(-2, 2, size=(n, 3))
    q = p @ T[:3, :3].T + T[:3, 3] + rng.normal(scale=noise, size=(n, 3))
    right = rng.random(n) >= wrong
    q[~right] = rng.uniform(-3, 3, size=(np.sum(~right), 3))
    return p.astype(np.float32), q.astype(np.float32), T, right


def error(result, T: np.ndarray) -> tuple[float, float]:
    return motion_error(np.asarray(se3.matrix(result.T_target_source), np.float64), T)


def test_least_squares_is_the_minimum(rng):
    p, q, _, _ = matched(rng, noise=0.1)
    weights = rng.random(COUNT).astype(np.float32)
    result = rigid_from_matches(p, q, weights, method="least_squares")
    mean_p, mean_q = weights @ p / weights.sum(), weights @ q / weights.sum()
    rotation = Rotation.align_vectors(q - mean_q, p - mean_p, weights)[0].as_matrix()
    found = np.asarray(se3.matrix(result.T_target_source))
    np.testing.assert_allclose(found[:3, :3], rotation, atol=2e-5)
    np.testing.assert_allclose(found[:3, 3], mean_q - rotation @ mean_p, atol=5e-5)
    assert result.converged
    assert result.num_inliers == COUNT


def test_half_turns_and_mirror_images_are_met_by_rotations(rng):
    p = rng.normal(size=(COUNT, 3)).astype(np.float32)
    turn = np.diag([1.0, -1.0, -1.0]).astype(np.float32)
    result = rigid_from_matches(p, p @ turn, method="least_squares")
    np.testing.assert_allclose(se3.matrix(result.T_target_source)[:3, :3], turn, atol=1e-5)
    mirrored = rigid_from_matches(p, p * [1, 1, -1], method="least_squares")
    assert np.linalg.det(np.asarray(se3.matrix(mirrored.T_target_source))[:3, :3]) == pytest.approx(
        1, abs=1e-5
    )


@pytest.mark.parametrize(("method", "wrong"), [("graduated", 0.6), ("ransac", 0.7)])
def test_wrong_matches_are_found_out(rng, key, method, wrong):
    for _ in range(3):
        p, q, T, right = matched(rng, wrong=wrong)
        result = rigid_from_matches(p, q, method=method, key=key)
        metres, degrees = error(result, T)
        assert metres < 5e-3
        assert degrees < 0.1
        assert result.converged
        assert np.mean(np.asarray(result.inliers) == right) > 0.99
        assert result.num_inliers == np.sum(result.inliers)
        assert 0.004 < result.rmse < 0.015


@pytest.mark.parametrize("method", ["least_squares", "graduated", "ransac"])
def test_without_the_last_minimisation_the_motion_is_near_and_has_no_derivatives(rng, key, method):
    p, q, T, right = matched(rng, wrong=0.0 if method == "least_squares" else 0.5)

    def total(p):
        result = rigid_from_matches(p, q, method=method, key=key, refined=False)
        return jnp.sum(result.T_target_source.wxyz_xyz), result

    gradient, result = jax.grad(total, has_aux=True)(jnp.asarray(p))
    metres, degrees = error(result, T)
    assert metres < 5e-3
    assert degrees < 0.1
    assert np.mean(np.asarray(result.inliers) == right) > 0.99
    np.testing.assert_array_equal(gradient, 0)


def test_matches_without_any_agreement_are_not_called_converged(rng, key):
    p, q, _, _ = matched(rng, wrong=1.0)
    for method in ("graduated", "ransac"):
        assert not rigid_from_matches(p, q, method=method, key=key).converged


@pytest.mark.parametrize("method", ["least_squares", "graduated", "ransac"])
@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_few_matches_make_no_nan_and_say_what_they_fix(rng, key, method, count):
    p, q, T, _ = matched(rng, count, noise=0.0)

    def total(p, q):
        result = rigid_from_matches(p, q, method=method, key=key)
        return jnp.sum(result.T_target_source.wxyz_xyz), result

    gradients, result = jax.grad(total, argnums=(0, 1), has_aux=True)(jax.device_put(p), jax.device_put(q))
    assert all(np.all(np.isfinite(x)) for x in (*gradients, *jax.tree.leaves(result)))
    assert bool(result.converged) == bool(result.unique) == (count == 3)
    if count == 3:
        assert error(result, T)[0] < 1e-3
    if count == 0:
        np.testing.assert_array_equal(result.T_target_source.wxyz_xyz, [1, 0, 0, 0, 0, 0, 0])
    if count in (1, 2):
        found = np.asarray(se3.matrix(result.T_target_source))
        np.testing.assert_allclose((found[:3, :3] @ p.mean(axis=0)) + found[:3, 3], q.mean(axis=0), atol=2e-3)


def test_points_on_a_line_leave_the_turn_about_it(rng):
    p = np.outer(np.linspace(-1, 1, COUNT), [1.0, 2.0, -1.0]).astype(np.float32)
    result = rigid_from_matches(p, p + np.float32(0.5), method="least_squares")
    assert not result.unique
    assert not result.converged
    found = np.asarray(se3.matrix(result.T_target_source))
    np.testing.assert_allclose(found[:3, :3], np.eye(3), atol=1e-3)  # no turn that nothing asks for
    np.testing.assert_allclose(found[:3, 3], 0.5, atol=1e-3)


def test_masked_and_broken_rows_don_t_count(rng, key):
    p, q, T, _ = matched(rng)
    p[:10], q[10:20], q[20:40] = np.nan, np.inf, 7.0
    valid = np.arange(COUNT) >= 40
    valid[:20] = True
    for method in ("least_squares", "graduated", "ransac"):
        result = rigid_from_matches(p, q, valid=valid, method=method, key=key)
        assert error(result, T)[0] < 5e-3
        assert result.num_inliers == COUNT - 40
        assert not np.any(np.asarray(result.inliers)[:40])


def test_matches_far_from_the_origin(rng):
    p, q, T, _ = matched(rng)
    away = np.array([4e3, -2e3, 1e3], np.float32)
    result = rigid_from_matches(p + away, q + away)
    moved = np.asarray(se3.transform(result.T_target_source, jnp.asarray(p + away)), np.float64) - away
    expected = p @ T[:3, :3].T + T[:3, 3]
    assert np.abs(moved - expected).max() < 0.01  # float32 holds such a position to half a millimetre


def test_it_batches(rng, key):
    lists = [matched(rng, 40, wrong=0.3) for _ in range(3)]
    p, q = (np.stack([x[i] for x in lists]) for i in (0, 1))
    results = jax.vmap(lambda p, q: rigid_from_matches(p, q))(p, q)
    for i, (_, _, T, _) in enumerate(lists):
        assert error(jax.tree.map(lambda x, i=i: x[i], results), T)[0] < 0.01


@pytest.mark.parametrize("method", ["least_squares", "graduated"])
def test_derivatives_are_those_of_finite_differences(float64, rng, method):
    p, q, _, _ = matched(rng, 12, wrong=0.2, noise=0.01)
    p, q, weights = (jnp.asarray(x, jnp.float64) for x in (p, q, rng.uniform(0.5, 1, 12)))

    def motion(p, q, weights):
        return rigid_from_matches(p, q, weights, method=method).T_target_source.wxyz_xyz

    rates = tuple(jnp.asarray(rng.normal(size=x.shape)) for x in (p, q, weights))

    def motion_and_rate(s):
        """By one program: another for the motion alone would have to be compiled."""
        return jax.jvp(motion, tuple(x + s * r for x, r in zip((p, q, weights), rates, strict=True)), rates)

    h = 1e-5
    (_, found), (up, _), (down, _) = (motion_and_rate(s) for s in (0, h, -h))
    np.testing.assert_allclose(found, (up - down) / (2 * h), rtol=1e-4, atol=1e-5)


def test_bad_input_is_refused():
    points = jnp.zeros((5, 3))
    with pytest.raises(InputError, match="one row each"):
        rigid_from_matches(points, points[:4])
    with pytest.raises(InputError, match="give it a key"):
        rigid_from_matches(points, points, method="ransac")
