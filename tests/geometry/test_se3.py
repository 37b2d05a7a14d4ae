"""The pose conventions: T_target_source, translation first, perturbed on the right."""

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest
import scipy.linalg

from sfgs_jax.arrays import InputError
from sfgs_jax.geometry import (
    inverse_right_jacobian,
    quaternions_from_rotations,
    rotation_vectors,
    rotations_from_quaternions,
    se3,
    slerp,
)


def random_pose(key):
    return se3.exp(jax.random.normal(key, (6,)))


def test_tangent_is_translation_first():
    T = se3.exp(jnp.asarray([1.0, 2.0, 3.0, 0.0, 0.0, 0.0]))
    np.testing.assert_allclose(se3.matrix(T)[:3, 3], [1, 2, 3])
    turned = se3.exp(jnp.asarray([0.0, 0.0, 0.0, 0.0, 0.0, jnp.pi / 2]))
    np.testing.assert_allclose(se3.transform(turned, jnp.asarray([1.0, 0.0, 0.0])), [0, 1, 0], atol=1e-6)


def test_quaternions_are_wxyz():
    np.testing.assert_allclose(se3.identity().wxyz_xyz, [1, 0, 0, 0, 0, 0, 0])


def test_compose_is_the_matrix_product(key):
    a, b = (random_pose(k) for k in jax.random.split(key))
    np.testing.assert_allclose(se3.matrix(se3.compose(a, b)), se3.matrix(a) @ se3.matrix(b), atol=1e-5)
    np.testing.assert_allclose(se3.log(se3.compose(a, se3.inverse(a))), np.zeros(6), atol=1e-5)


def test_transform_takes_source_points_to_the_target_frame(key):
    T = random_pose(key)
    points = jax.random.normal(key, (4, 5, 3))
    expected = points @ se3.matrix(T)[:3, :3].T + se3.matrix(T)[None, None, :3, 3]
    np.testing.assert_allclose(se3.transform(T, points), expected, atol=1e-5)


def test_adjoint_moves_a_perturbation_from_right_to_left(key):
    T = random_pose(key)
    delta = 0.1 * jax.random.normal(key, (6,))
    right = se3.compose(T, se3.exp(delta))
    left = se3.compose(se3.exp(se3.adjoint(T) @ delta), T)
    np.testing.assert_allclose(se3.matrix(right), se3.matrix(left), atol=1e-5)


def test_many_compositions_keep_the_quaternion_unit_long(key):
    small = se3.exp(0.1 * jax.random.normal(key, (6,)))
    T = jax.lax.fori_loop(0, 2000, lambda _, T: se3.compose(T, small), se3.identity())
    np.testing.assert_allclose(jnp.linalg.norm(T.wxyz_xyz[:4]), 1.0, atol=1e-6)


def test_perturbation_at_zero_has_the_generators_as_derivative():
    point = jnp.asarray([1.0, 2.0, 3.0])
    jacobian = jax.jit(jax.jacobian(lambda d: se3.transform(se3.exp(d), point)))(jnp.zeros(6))
    np.testing.assert_allclose(jacobian[:, :3], np.eye(3), atol=1e-6)
    np.testing.assert_allclose(jacobian[:, 3:], [[0, 3, -2], [-3, 0, 1], [2, -1, 0]], atol=1e-6)


@pytest.mark.parametrize("angle", [0.0, 1e-6, 0.09, 0.11, 3.0])
def test_exponential_and_matrix_are_those_of_the_host_at_every_angle(float64, key, angle):
    moved, axis = jax.random.normal(key, (2, 3))
    tangent = jnp.concatenate([moved, angle * axis / jnp.linalg.norm(axis)])
    generator = np.zeros((4, 4))
    generator[:3, :3] = np.cross(np.eye(3), tangent[3:])
    generator[:3, 3] = moved
    np.testing.assert_allclose(se3.matrix(se3.exp(tangent)), scipy.linalg.expm(generator), atol=1e-13)


@pytest.mark.parametrize("angle", [0.0, 1e-6, 0.09, 0.11, 3.0])
def test_the_exponentials_derivative_is_the_slope(float64, key, angle):
    moved, axis, *along = jax.random.normal(key, (4, 3))
    tangent, along = jnp.concatenate([moved, angle * axis / jnp.linalg.norm(axis)]), jnp.concatenate(along)
    _, rate = jax.jvp(lambda x: se3.exp(x).wxyz_xyz, (tangent,), (along,))
    ends = [se3.exp(tangent + sign * 1e-6 * along).wxyz_xyz for sign in (1, -1)]
    np.testing.assert_allclose(rate, (ends[0] - ends[1]) / 2e-6, atol=1e-8)


def test_matrices_on_host_and_device_agree(key):
    poses = jax.vmap(random_pose)(jax.random.split(key, 20))
    matrices = se3.to_matrices(poses)
    assert matrices.dtype == np.float64
    np.testing.assert_allclose(matrices, jax.vmap(se3.matrix)(poses), atol=1e-5)
    for matrix in matrices[:3]:
        np.testing.assert_allclose(se3.matrix(se3.from_matrix(matrix)), matrix, atol=1e-6)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1.0, np.pi - 1e-9, np.pi, 4.0])
@pytest.mark.parametrize("axis", [[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [0.6, 0.0, -0.8], [1 / 3**0.5] * 3])
def test_host_quaternions_are_exact_at_every_angle(angle, axis):
    quaternion = np.asarray([[np.cos(angle / 2), *(np.sin(angle / 2) * np.asarray(axis))]])
    rotation = rotations_from_quaternions(quaternion)
    np.testing.assert_allclose(np.linalg.det(rotation), 1.0, atol=1e-14)
    back = quaternions_from_rotations(rotation)
    np.testing.assert_allclose(rotations_from_quaternions(back), rotation, atol=1e-14)
    assert back[0, 0] >= 0
    on_device = se3.quaternions(jnp.asarray(rotation, jnp.float32))
    np.testing.assert_allclose(np.abs(np.sum(np.asarray(on_device) * back)), 1.0, atol=1e-6)


def test_the_extent_is_the_tangents_two_lengths(key):
    tangents = jax.random.normal(key, (5, 6))
    metres, radians = se3.extent(se3.exp(tangents))
    np.testing.assert_allclose(metres, np.linalg.norm(tangents[:, :3], axis=1), rtol=1e-4)
    np.testing.assert_allclose(radians, np.linalg.norm(tangents[:, 3:], axis=1), rtol=1e-4)


def test_quaternion_products_turn_by_the_second_then_by_the_first(key):
    a, b = (se3.exp(jax.random.normal(k, (7, 6))) for k in jax.random.split(key))
    product = se3.quaternion_product(a.wxyz_xyz[:, :4], b.wxyz_xyz[:, :4])
    expected = se3.rotation_matrix(a) @ se3.rotation_matrix(b)
    np.testing.assert_allclose(rotations_from_quaternions(np.asarray(product)), expected, atol=1e-5)
    doubled = se3.quaternion_product(a.wxyz_xyz[:, :4], 2 * b.wxyz_xyz[:, :4])
    np.testing.assert_allclose(doubled, 2 * product, rtol=1e-6)


def test_rotated_points_are_those_of_the_matrix(key):
    T = se3.exp(jax.random.normal(key, (7, 6)))
    points = jax.random.normal(key, (7, 3))
    expected = jnp.einsum("nij,nj->ni", se3.rotation_matrix(T), points)
    np.testing.assert_allclose(se3.rotate(T.wxyz_xyz[:, :4], points), expected, atol=1e-5)


def test_host_and_device_agree_on_logs_and_adjoints(float64, key):
    T = se3.exp(jax.random.normal(key, (30, 6)))
    matrices = se3.to_matrices(T)
    np.testing.assert_allclose(se3.logs_of(matrices), se3.log(T), atol=1e-9)
    np.testing.assert_allclose(se3.adjoints_of(matrices), se3.adjoint(T), atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-5, 1e-3, 1.0, 3.1])
def test_host_exponentials_undo_the_logs(angle):
    tangents = np.asarray([[1.0, -2.0, 3.0, *(angle * np.asarray([0.36, 0.48, -0.8]))]])
    np.testing.assert_allclose(se3.logs_of(se3.exps_of(tangents)), tangents, rtol=1e-11, atol=1e-15)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-5, 1.0, np.pi - 1e-6, np.pi])
def test_host_logs_are_exact_at_every_angle(angle):
    axis = np.asarray([0.36, 0.48, -0.8])
    half = np.asarray([[np.cos(angle / 2), *(np.sin(angle / 2) * axis)]])
    rotation = rotations_from_quaternions(half)
    turn = rotation_vectors(rotation)
    np.testing.assert_allclose(np.abs(turn[0] @ axis), angle, rtol=1e-14, atol=1e-15)
    T = np.eye(4)[None].copy()
    T[0, :3, :3], T[0, :3, 3] = rotation[0], [1.0, -2.0, 3.0]
    # exp of the log by its series: matrix powers of the generator.
    v, w = np.split(se3.logs_of(T)[0], 2)
    generator = np.zeros((4, 4))
    generator[:3, :3], generator[:3, 3] = np.cross(np.eye(3), w), v
    series, term = np.eye(4), np.eye(4)
    for n in range(1, 40):
        term = term @ generator / n
        series += term
    np.testing.assert_allclose(series, T[0], atol=1e-9)


ANGLES = [0.0, 1e-9, 1e-4, 0.0199, 0.0201, 0.1, 0.1999, 0.2001, 1.0, 3.0, np.pi - 1e-6]


def on_the_device(angle, dtype, sign):
    """A motion by its tangent, with either quaternion of its rotation."""
    axis = np.asarray([0.36, 0.48, -0.8])
    tangent = np.asarray([1.0, -2.0, 3.0, *(angle * axis)])
    matrix = np.concatenate([[np.cos(angle / 2), *(np.sin(angle / 2) * axis)], [0, 0, 0]])
    matrix[4:] = se3.exps_of(tangent[None])[0, :3, 3]
    matrix[:4] *= sign
    return jaxlie.SE3(jnp.asarray(matrix, dtype)), tangent


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("angle", ANGLES)
def test_logs_are_exact_at_every_angle(float64, angle, sign):
    T, tangent = on_the_device(angle, jnp.float64, sign)
    np.testing.assert_allclose(se3.log(T), tangent, atol=2e-13 if angle < 3.1 else 1e-8)
    back = se3.exp(jnp.asarray(tangent))
    np.testing.assert_allclose(se3.matrix(back), se3.matrix(T), atol=1e-12)
    single, _ = on_the_device(angle, jnp.float32, sign)
    np.testing.assert_allclose(se3.log(single), tangent, atol=2e-6 if angle < 3.1 else 3e-3)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("angle", ANGLES)
def test_logs_and_exponentials_have_their_derivatives_at_every_angle(float64, angle, sign):
    T, tangent = on_the_device(angle, jnp.float64, sign)
    zero = jnp.zeros(6)
    found = jax.jacfwd(lambda d: se3.log(se3.compose(T, se3.exp(d))))(zero)
    expected = inverse_right_jacobian(jnp.asarray(tangent)[:, None])[:, :, 0]
    np.testing.assert_allclose(found, expected, atol=1e-9 if angle < 3.1 else 1e-6)
    back = jax.jacrev(lambda x: se3.log(se3.exp(x)))(jnp.asarray(tangent))
    np.testing.assert_allclose(back, np.eye(6), atol=1e-9 if angle < 3.1 else 1e-3)


def test_slerp_turns_evenly_on_the_shortest_arc(rng):
    start = rotations_from_quaternions(rng.normal(size=(20, 4)))
    end = rotations_from_quaternions(rng.normal(size=(20, 4)))
    whole = rotation_vectors(np.swapaxes(start, 1, 2) @ end)
    fraction = rng.uniform(size=(20, 1))
    part = rotation_vectors(np.swapaxes(start, 1, 2) @ slerp(start, end, fraction))
    np.testing.assert_allclose(part, fraction * whole, atol=1e-7)
    np.testing.assert_allclose(slerp(start, end, np.zeros((20, 1))), start, atol=1e-12)
    np.testing.assert_allclose(slerp(start, end, np.ones((20, 1))), end, atol=1e-12)
    np.testing.assert_allclose(slerp(start, start, fraction), start, atol=1e-12)


@pytest.mark.parametrize("on", [np.float64, np.float32, jnp.float32])
def test_a_matrix_is_a_pose(key, on):
    T = random_pose(key)
    matrix = on(se3.to_matrices(T.__class__(T.wxyz_xyz[None]))[0])
    pose = se3.as_se3(matrix)
    np.testing.assert_allclose(se3.matrix(pose), matrix, atol=1e-6)
    assert pose.wxyz_xyz.dtype == jnp.float32
    point = jnp.asarray([1.0, 2.0, 3.0])
    np.testing.assert_allclose(se3.transform(matrix, point), se3.transform(T, point), atol=1e-5)
    np.testing.assert_allclose(se3.log(se3.compose(matrix, se3.inverse(T))), np.zeros(6), atol=1e-5)
    assert se3.as_se3(T) is T


def test_traced_matrices_are_poses_with_gradients(key):
    T = se3.matrix(random_pose(key))
    point = jnp.asarray([1.0, 2.0, 3.0])

    def moved(matrix):
        return jnp.sum(se3.transform(matrix, point))

    np.testing.assert_allclose(jax.jit(moved)(T), moved(T), rtol=1e-5)
    slope = jax.jit(jax.grad(moved))
    np.testing.assert_allclose(slope(T)[:3, 3], np.ones(3), rtol=1e-5)
    assert np.all(np.isfinite(slope(jnp.eye(4))))
    both = jnp.stack([T, jnp.eye(4)])
    assert jax.vmap(lambda m: se3.as_se3(m).wxyz_xyz)(both).shape == (2, 7)
    assert jax.jit(lambda m: se3.as_se3(m, axes=1).wxyz_xyz)(both).shape == (2, 7)


SHEARED = np.eye(4)
SHEARED[0, 1] = 0.1
TRANSPOSED = np.eye(4)
TRANSPOSED[3, 0] = 2.0


@pytest.mark.parametrize(
    ("pose", "words"),
    [
        (np.eye(3), r"Start is a jaxlie.SE3 or a 4 x 4 matrix, not an array of shape \(3, 3\)"),
        (np.zeros(7), r"not an array of shape \(7,\)"),
        (np.tile(np.eye(4), (5, 1, 1)), r"one motion; use vmap for several, not matrices of shape \(5,\)"),
        (SHEARED, "no rigid motion: .* orthonormal"),
        (TRANSPOSED, "last row 0 0 0 1"),
        (np.diag([1.0, 1, -1, 1]), "no rigid motion"),
        (2 * np.eye(4), "no rigid motion"),
        (np.full((4, 4), np.nan), "no rigid motion"),
    ],
)
def test_other_things_are_no_poses(pose, words):
    with pytest.raises(InputError, match=words):
        se3.as_se3(pose, name="Start")


def test_motions_in_number_are_no_single_pose():
    with pytest.raises(InputError, match=r"use vmap for several, not motions of shape \(2,\)"):
        se3.as_se3(se3.exp(jnp.zeros((2, 6))))
    with pytest.raises(InputError, match="an array of motions with 1 axis"):
        se3.as_se3(np.eye(4), axes=1)


def test_the_derivative_of_distances_along_normals_is_that_of_the_motion(rng, float64):
    points, normals = (jnp.asarray(rng.normal(size=(3, 5))) for _ in range(2))

    def distances(tangent):
        return jnp.sum(normals.T * se3.transform(se3.exp(tangent), points.T), axis=1)

    expected = jax.jacfwd(distances)(jnp.zeros(6)).T
    np.testing.assert_allclose(se3.plane_jacobian(points, normals), expected, atol=1e-12)
