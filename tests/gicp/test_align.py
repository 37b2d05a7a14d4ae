"""Alignment of depth images: known motions, quality measures of the result, inputs that can't work."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.geometry import Camera, se3
from sfgs_jax.gicp import (
    GicpConfig,
    MotionPrior,
    OrganisedCloud,
    RegistrationResult,
    align,
    level_problem,
    prepare,
)
from tests.gicp.scenes import CORNER, WALL, cast, motion_error

CAMERA = Camera(150.0, 150.0, 79.5, 59.5, width=160, height=120)
# Images a quarter the usual width have points to spare at the finest level alone. Steps go on until they are
# shorter than the errors from noise, because these are compared with the errors that the result predicts.
CONFIG = GicpConfig(
    noise=0.001, noise_per_square_metre=0.0, strides=(2, 1, 1, 1), min_points=(1,), tolerance=(1e-5,)
)
MOTION = np.asarray(se3.matrix(se3.exp(jnp.asarray([0.03, -0.02, 0.04, 0.02, -0.03, 0.015]))), np.float64)


def clouds(depth_target, depth_source, config=CONFIG) -> tuple[OrganisedCloud, OrganisedCloud]:
    return prepare(depth_target, CAMERA, config=config), prepare(depth_source, CAMERA, config=config)


def finite(result: RegistrationResult) -> bool:
    return all(bool(np.all(np.isfinite(leaf))) for leaf in jax.tree.leaves(result))


@pytest.fixture(scope="module")
def corner() -> tuple[OrganisedCloud, OrganisedCloud]:
    """Target, and source moved by MOTION."""
    return clouds(cast(CAMERA), cast(CAMERA, MOTION))


def test_a_known_motion_is_recovered(corner):
    target, source = corner
    result = align(source, target, se3.identity(), config=CONFIG)
    metres, degrees = motion_error(np.asarray(se3.matrix(result.T_target_source), np.float64), MOTION)
    assert metres < 1e-3
    assert degrees < 0.05
    assert result.converged
    assert result.inlier_fraction > 0.85
    assert result.rmse < 1e-3
    assert 3 <= int(result.iterations) <= sum(CONFIG.max_iterations)


def test_from_a_near_start_the_finest_level_suffices(corner, compilations):
    target, source = corner
    start = se3.compose(
        se3.from_matrix(MOTION),
        se3.exp(jnp.asarray([0.005, -0.004, 0.003, 0.004, 0.002, -0.003])),
    )
    whole = align(source, target, start, config=CONFIG)
    compiled, levels = len(compilations), (0, 1, CONFIG.levels - 1)
    results = [align(source, target, start, coarsest=level, config=CONFIG) for level in levels]
    assert len(compilations) == compiled
    for coarsest, result in zip(levels, results, strict=True):
        off = se3.log(se3.compose(se3.inverse(whole.T_target_source), result.T_target_source))
        np.testing.assert_allclose(off, 0, atol=5e-5)
        assert result.converged
        assert (result.iterations < whole.iterations) == (coarsest < CONFIG.levels - 1)


def test_point_to_plane_recovers_it_too(corner):
    target, source = corner
    result = align(source, target, se3.identity(), config=replace(CONFIG, residual="point_to_plane"))
    metres, degrees = motion_error(np.asarray(se3.matrix(result.T_target_source), np.float64), MOTION)
    assert metres < 1e-3
    assert degrees < 0.03


def test_point_to_point_recovers_a_motion_along_the_view():
    target, source = (cast(CAMERA, planes=[([0, 0, -1.0], -z)], spheres=[]) for z in (2.0, 1.96))
    config = replace(CONFIG, residual="point_to_point")
    target, source = clouds(target, source, config)
    result = align(source, target, se3.identity(), config=config)
    found = np.asarray(se3.matrix(result.T_target_source), np.float64)
    np.testing.assert_allclose(found[:3, 3], [0, 0, 0.04], atol=1e-3)
    assert result.converged


def test_identical_clouds_stay_where_they_are(corner):
    target, _ = corner
    result = align(target, target, se3.identity(), config=CONFIG)
    metres, degrees = motion_error(np.asarray(se3.matrix(result.T_target_source), np.float64), np.eye(4))
    assert metres < 1e-5
    assert degrees < 1e-3
    assert result.converged
    assert result.inlier_fraction > 0.999
    assert finite(result)
    by_matrix = align(target, target, np.eye(4), config=CONFIG)
    np.testing.assert_array_equal(by_matrix.T_target_source.wxyz_xyz, result.T_target_source.wxyz_xyz)


def test_start_and_depth_and_intrinsics_compile_once(corner, compilations):
    target, source = corner
    start = se3.exp(jnp.asarray([0.01, 0, 0, 0, 0, 0.02]))
    other = Camera(140, 141.0, jnp.asarray(80.0), 60, width=160, height=120)
    cloud = prepare(cast(CAMERA), other, config=CONFIG)
    align(source, target, se3.identity(), config=CONFIG)
    before = len(compilations)
    align(target, source, start, config=CONFIG)
    align(cloud, cloud, se3.from_matrix(MOTION), config=CONFIG)
    assert len(compilations) == before


def test_the_information_matrix_is_that_of_a_dense_computation(corner):
    target, source = corner
    noise = np.random.default_rng(1).normal(scale=0.002, size=CAMERA.shape).astype(np.float32)
    source = prepare(cast(CAMERA, MOTION) + noise, CAMERA, config=CONFIG)
    result = align(source, target, se3.identity(), config=CONFIG)

    T = np.asarray(se3.matrix(result.T_target_source), np.float64)

    # The assessment takes every second of the rows and columns that are aligned.
    @jax.jit
    def found(source, target, T_target_source):
        problem = level_problem(source.levels, target.levels, None, 0, CONFIG, decimation=2)
        return problem.source, problem.correspondences(T_target_source)

    stride = 2 * CONFIG.strides[0]
    points, pairs = found(source, target, result.T_target_source)
    information, excess, weight = np.zeros((6, 6)), 0.0, 0.0
    for n in np.flatnonzero(pairs.valid):
        p, q, t = (np.asarray(x, np.float64)[:, n] for x in (points.points, pairs.points, pairs.normals))
        normal = T[:3, :3] @ t
        mean = np.asarray(points.normals, np.float64)[:, n] + t
        distance = (p - q) @ mean / np.linalg.norm(mean)
        if abs(distance) >= CONFIG.inlier_width * CONFIG.noise:
            continue
        robust = min(1.0, CONFIG.kernel_width * CONFIG.noise / max(abs(distance), 1e-9))
        # Derivative of the distance of T exp(delta) p along the target's normal, column by column.
        row = np.zeros(6)
        for k in range(6):
            delta = np.zeros(6)
            delta[k] = 1
            skew = np.array([[0, -delta[5], delta[4]], [delta[5], 0, -delta[3]], [-delta[4], delta[3], 0]])
            row[k] = normal @ T[:3, :3] @ (delta[:3] + skew @ p)
        information += robust / CONFIG.noise**2 * np.outer(row, row)
        excess += robust * distance**2 / CONFIG.noise**2
        weight += robust
    redundancy = ((2 * CONFIG.radius + 1) / stride) ** 2
    expected = information / (excess / weight) / redundancy
    np.testing.assert_allclose(result.information, expected, rtol=0.01, atol=1e-3 * np.abs(expected).max())
    np.testing.assert_allclose(
        np.asarray(result.covariance, np.float64) @ np.asarray(result.information, np.float64),
        np.eye(6),
        atol=1e-3,
    )


def test_the_information_matrix_predicts_the_errors_from_noise():
    """The image is so large that noise counts for more than the windows' bias at curved surfaces and edges.

    Squared errors weighted by a right information have a mean of 6. The predicted spread fits, except for the
    rotation about the optical axis, whose errors are half the prediction (0.5 to 0.6).
    """
    camera = Camera(300.0, 300.0, 159.5, 119.5, width=320, height=240)
    config = GicpConfig(levels=1, tolerance=(1e-5,))  # it starts from the true motion
    depths, T = (cast(camera), cast(camera, MOTION)), se3.from_matrix(MOTION)
    rng, errors, predicted, squares = np.random.default_rng(2), [], [], []
    for _ in range(40):
        noise = (rng.normal(scale=config.noise + config.noise_per_square_metre * d**2) for d in depths)
        noisy = ((d + n).astype(np.float32) for d, n in zip(depths, noise, strict=True))
        target, source = (prepare(d, camera, config=config) for d in noisy)
        result = align(source, target, T, config=config)
        error = np.asarray(se3.log(se3.compose(se3.inverse(T), result.T_target_source)), np.float64)
        information = np.asarray(result.information, np.float64)
        errors.append(error)
        squares.append(error @ information @ error)
        predicted.append(np.diag(np.linalg.inv(information)))
    assert 0.6 < np.mean(squares) / 6 < 1.3
    ratio = np.std(errors, axis=0) / np.sqrt(np.mean(predicted, axis=0))
    assert np.all(ratio > 0.4)
    assert np.all(ratio < 1.4)


def test_a_bare_wall_leaves_motion_along_it_free():
    wall = clouds(cast(CAMERA, planes=WALL, spheres=[]), cast(CAMERA, planes=WALL, spheres=[]))
    normal = np.asarray(WALL[0][0]) / np.linalg.norm(WALL[0][0])
    start = np.eye(4)
    start[:3, 3] = [0.05, 0.03, 0.02]
    result = align(*wall, se3.from_matrix(start), config=CONFIG)
    found = np.asarray(se3.matrix(result.T_target_source), np.float64)
    assert finite(result)
    assert abs(found[:3, 3] @ normal) < 1e-3  # the wall fixes the shift along its normal
    assert np.all(np.isinf(result.covariance))
    np.testing.assert_array_less(np.asarray(result.observability[:3]), 1e-3)
    assert np.all(np.asarray(result.observability[3:]) > 0.01)
    for direction in np.asarray(result.directions[:, :3], np.float64).T:
        moved = np.asarray(se3.matrix(se3.exp(jnp.asarray(direction * 0.01, jnp.float32))), np.float64)
        # Points of the wall stay on it, to second order.
        points = np.asarray(wall[0].levels[0].points, np.float64)[10:-10:9, 10:-10:9].reshape(-1, 3)
        shift = (points @ moved[:3, :3].T + moved[:3, 3] - points) @ normal
        assert np.abs(shift).max() < 1e-3
    values = np.linalg.eigvalsh(np.asarray(result.information, np.float64))
    assert values[2] < 1e-3 * values[3]


def test_a_far_room_does_not_fix_the_turn_about_a_near_sphere():
    """A few distances good to centimetres say less than the errors of many near normals."""
    config = replace(
        CONFIG,
        levels=1,
        noise=GicpConfig().noise,
        noise_per_square_metre=GicpConfig().noise_per_square_metre,
    )
    room = [(normal, 5 * distance) for normal, distance in CORNER]
    centre, radius = np.asarray([0.0, 0.0, 1.6]), 0.6
    bare, near = (cast(CAMERA, planes=room, spheres=spheres) for spheres in ([], [(centre, radius)]))
    assert not np.any(align(*clouds(bare, bare, config), se3.identity(), config=config).free)
    result = align(*clouds(near, near, config), se3.identity(), config=config)
    np.testing.assert_array_equal(result.free, [True] * 3 + [False] * 3)
    turn = np.asarray([0.0, 1.0, 0.0])
    about_centre = np.concatenate([-np.cross(turn, centre), turn])
    about_camera = np.concatenate([np.zeros(3), turn])
    information = np.asarray(result.information, np.float64)
    assert about_centre @ information @ about_centre < 1e-3 * (about_camera @ information @ about_camera)


def test_a_prior_without_information_has_no_effect():
    """Along a bare wall rounding must not drift in a direction that neither surface nor prior fixes."""
    wall = clouds(cast(CAMERA, planes=WALL, spheres=[]), cast(CAMERA, planes=WALL, spheres=[]))
    start = se3.exp(jnp.asarray([0.05, 0.03, 0.02, 0.0, 0.0, 0.0]))
    nothing = MotionPrior(se3.identity(), jnp.zeros((6, 6)))
    without, with_nothing = (align(*wall, start, prior=prior, config=CONFIG) for prior in (None, nothing))
    np.testing.assert_allclose(
        with_nothing.T_target_source.wxyz_xyz, without.T_target_source.wxyz_xyz, atol=1e-4
    )


def test_clouds_that_do_not_overlap_are_not_called_converged():
    target, source = clouds(cast(CAMERA), cast(CAMERA))
    far = np.eye(4)
    far[:3, 3] = [30.0, 0, 0]
    result = align(source, target, se3.from_matrix(far), config=CONFIG)
    assert finite(result)
    assert not result.converged
    assert result.inlier_fraction == 0
    assert not np.any(result.information)


@pytest.mark.parametrize("missing", ["source", "target", "both"])
def test_no_depth_is_not_called_converged(missing):
    depth, empty = cast(CAMERA), np.full(CAMERA.shape, np.nan, np.float32)
    target, source = clouds(depth if missing == "source" else empty, depth if missing == "target" else empty)
    start = se3.from_matrix(MOTION)
    result = align(source, target, start, config=CONFIG)
    assert finite(result)
    assert not result.converged
    assert result.inlier_fraction == 0
    np.testing.assert_allclose(result.T_target_source.wxyz_xyz, start.wxyz_xyz, atol=1e-6)


def test_overlap_counts_surfaces_of_the_target_that_fit_or_not():
    depth = cast(CAMERA)
    half, wrong = depth.copy(), depth.copy()
    half[:, 80:] = 0
    wrong[:, 80:] += 0.3
    source = prepare(depth, CAMERA, config=CONFIG)
    whole, part, other = (
        align(source, prepare(d, CAMERA, config=CONFIG), se3.identity(), config=CONFIG)
        for d in (depth, half, wrong)
    )
    assert whole.overlap > 0.99
    assert other.overlap > 0.7
    assert 0.4 < part.overlap < 0.6
    assert part.inlier_fraction > 0.95 * part.overlap
    # The rest meets no surface, though the target looks there.
    assert whole.unmeasured < 0.01
    np.testing.assert_allclose(part.unmeasured, 1 - part.overlap, atol=0.01)
    assert other.inlier_fraction < 0.7 * other.overlap


def test_few_points_are_not_called_converged():
    depth = np.zeros(CAMERA.shape, np.float32)
    depth[50:62, 70:84] = cast(CAMERA)[50:62, 70:84]
    target, source = clouds(depth, depth)
    assert 0 < target.levels[0].valid.sum() < 60
    result = align(source, target, se3.identity(), config=CONFIG)
    assert finite(result)
    assert not result.converged


def test_a_wrong_surface_in_view_is_outvoted(corner):
    target, _ = corner
    depth = cast(CAMERA, MOTION)
    depth[20:70, 20:60] -= 0.03  # a patch that moved by itself, within the distance gate
    result = align(prepare(depth, CAMERA, config=CONFIG), target, se3.identity(), config=CONFIG)
    metres, degrees = motion_error(np.asarray(se3.matrix(result.T_target_source), np.float64), MOTION)
    assert metres < 3e-3
    assert degrees < 0.15
    assert result.inlier_fraction < 0.85


def test_levels_have_their_sizes_cameras_and_no_points_across_edges():
    cloud = prepare(cast(CAMERA), CAMERA, config=CONFIG)
    assert [level.valid.shape for level in cloud.levels] == [(60, 80), (30, 40), (15, 20), (7, 10)]
    for level in cloud.levels:
        assert level.camera.shape == level.valid.shape
        valid = np.asarray(level.valid)
        pixels = np.asarray(level.camera.project(level.points))[valid]
        np.testing.assert_allclose(pixels, np.asarray(level.camera.pixels())[valid], atol=1e-3)
        assert not np.any(np.asarray(level.normals)[~valid])


def test_mismatched_input_is_refused(corner):
    target, source = corner
    for cloud, other in ((source, target), (prepare(cast(CAMERA), CAMERA), source)):
        with pytest.raises(InputError, match="prepare both clouds with this config"):
            align(cloud, other, se3.identity(), config=replace(CONFIG, levels=2))
    with pytest.raises(InputError, match=r"of its camera's shape \(120, 160\), not"):
        prepare(jnp.ones((60, 80)), CAMERA)
    with pytest.raises(InputError, match="ask for fewer levels"):
        prepare(jnp.ones((16, 16)), Camera(10, 10, 8, 8, width=16, height=16))
