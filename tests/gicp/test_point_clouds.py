"""Alignment of unorganised clouds and Gaussian maps, far from the origin and with hopeless input."""

from dataclasses import replace
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.arrays import InputError
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
from tests.gicp.lidar import street_scan
from tests.gicp.scenes import cast, motion_error

POINTS = PointsConfig(levels=2, max_points=2048)
COUNT = 7500
"""Points of most clouds here, between two sizes of programs, 7168 and 8192."""
MOTION = np.asarray(se3.matrix(se3.exp(jnp.asarray([0.06, -0.04, 0.05, 0.03, -0.04, 0.02]))), np.float64)


def room(rng, n: int = 6000) -> np.ndarray:
    """Points (N, 3) of three walls and a ball, float64 metres, with 1 mm of noise."""
    walls = rng.uniform(-1, 1, size=(n, 3))
    walls[np.arange(n), np.arange(n) % 3] = -1
    ball = rng.normal(size=(n // 4, 3))
    ball = 0.4 * ball / np.linalg.norm(ball, axis=1, keepdims=True) + 0.2
    return np.concatenate([walls, ball]) + rng.normal(scale=0.001, size=(n + n // 4, 3))


def moved(points: np.ndarray, T_target_source: np.ndarray) -> np.ndarray:
    """Target points in source coordinates."""
    T = np.linalg.inv(T_target_source)
    return points @ T[:3, :3].T + T[:3, 3]


def error(result, known: np.ndarray = MOTION) -> tuple[float, float]:
    return motion_error(np.asarray(se3.matrix(result.T_target_source), np.float64), known)


def finite(tree) -> bool:
    return all(bool(np.all(np.isfinite(leaf))) for leaf in jax.tree.leaves(tree))


@pytest.fixture(scope="module")
def scans() -> tuple[np.ndarray, np.ndarray]:
    """Two samplings of the room, the second in source coordinates."""
    rng = np.random.default_rng(5)
    return room(rng), moved(room(rng), MOTION)


@pytest.fixture(scope="module")
def clouds(scans):
    return tuple(prepare_points(points, config=POINTS) for points in scans)


@pytest.mark.parametrize("optimizer", ["gauss_newton", "levenberg_marquardt"])
def test_a_known_motion_is_recovered(clouds, optimizer):
    target, source = clouds
    result = align(source, target, se3.identity(), config=GicpConfig(optimizer=optimizer))
    metres, degrees = error(result)
    assert metres < 2e-3
    assert degrees < 0.1
    assert result.converged
    assert result.inlier_fraction > 0.8
    assert not np.any(result.free)
    assert target.overflow == 0


@pytest.mark.parametrize("kernel", ["cauchy", "tukey"])
def test_other_kernels_and_residuals_work_too(clouds, kernel):
    target, source = clouds
    config = GicpConfig(kernel=kernel, residual="point_to_plane", kernel_width=4.0)
    assert error(align(source, target, se3.identity(), config=config))[0] < 2e-3


def test_covariances_cover_the_errors():
    """Normalised squares of the errors, 6 on average if the covariances were exact."""
    squares = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        target, source = (prepare_points(p, config=POINTS) for p in (room(rng), moved(room(rng), MOTION)))
        result = align(source, target, se3.identity())
        T = np.asarray(se3.matrix(result.T_target_source), np.float64)
        (tangent,) = se3.logs_of((np.linalg.inv(MOTION) @ T)[None])
        squares.append(tangent @ np.asarray(result.information) @ tangent)
        np.testing.assert_allclose(
            np.asarray(result.covariance) @ np.asarray(result.information), np.eye(6), atol=1e-2
        )
    assert 0.5 < np.mean(squares) < 12


def test_clouds_of_about_one_size_share_a_program(scans, clouds, compilations):
    del clouds  # it has compiled the program
    compilations.clear()
    for count in (COUNT - 1, 7169):
        prepare_points(scans[0][:count], valid=np.arange(count) < 7000, config=POINTS)
    assert not compilations


def test_normals_are_those_of_the_walls(clouds):
    level = clouds[0].levels[0]
    points = np.asarray(level.points) + np.asarray(clouds[0].origin)
    for axis in range(3):
        on_wall = np.asarray(level.valid) & (np.abs(points[:, axis] + 1) < 0.005)
        on_wall &= np.all(np.delete(points, axis, axis=1) > -0.7, axis=1)
        assert on_wall.sum() > 30
        assert np.median(np.abs(np.asarray(level.normals)[on_wall, axis])) > 0.999


def test_clouds_kilometres_from_the_origin_are_aligned(scans):
    target, source = scans
    away = np.asarray([1e4, -3e3, 1e3])
    # Both stand in one frame far away; the motion turns about its origin.
    known = np.eye(4)
    known[:3, :3], known[:3, 3] = MOTION[:3, :3], MOTION[:3, 3] + away - MOTION[:3, :3] @ away
    start = np.eye(4)
    result = align(
        prepare_points(source + away, config=POINTS),
        prepare_points(target + away, config=POINTS),
        se3.from_matrix(start),
    )
    T = np.asarray(se3.matrix(result.T_target_source), np.float64)
    middle = (source + away).mean(axis=0)
    shift = (T[:3, :3] - known[:3, :3]) @ middle + T[:3, 3] - known[:3, 3]
    assert result.converged
    assert np.linalg.norm(shift) < 0.01  # float32 holds a position there to a millimetre
    assert motion_error(T, known)[1] < 0.1


@pytest.mark.parametrize("kind", ["isotropic", "map", "neighbours"])
def test_a_gaussian_map_is_a_target(scans, clouds, kind):
    target, _ = scans
    flat = np.broadcast_to(np.eye(3) * 1e-4, (len(target), 3, 3)).copy()
    walls = np.arange(6000)
    flat[walls, walls % 3, walls % 3] = 1e-6
    gaussians = prepare_gaussians(target, flat, target_covariance=kind, config=POINTS)
    result = align(clouds[1], gaussians, se3.identity())
    metres, degrees = error(result)
    assert metres < 3e-3
    assert degrees < 0.15
    assert result.converged


def test_depth_images_and_points_can_be_mixed(clouds):
    camera = Camera(150.0, 150.0, 79.5, 59.5, width=160, height=120)
    depth = cast(camera)
    motion = np.asarray(se3.matrix(se3.exp(jnp.asarray([0.02, -0.02, 0.03, 0.01, -0.02, 0.01]))), np.float64)
    config = GicpConfig(levels=2)
    organised = prepare(cast(camera, motion), camera, config=config)
    v, u = np.nonzero(depth)
    z = depth[v, u]
    points = np.column_stack([(u - 79.5) / 150 * z, (v - 59.5) / 150 * z, z])
    points = points[np.linspace(0, len(points) - 1, COUNT).astype(int)]
    unorganised = prepare_points(points, config=POINTS)
    assert error(align(organised, unorganised, se3.identity(), config=config), motion)[0] < 6e-3
    backwards = align(unorganised, organised, se3.identity(), config=config)
    assert error(backwards, np.linalg.inv(motion))[0] < 6e-3


def test_a_plane_is_not_observable_along_itself(rng):
    n = COUNT
    planes = []
    for _ in range(2):
        points = np.column_stack([rng.uniform(-1, 1, (n, 2)), rng.normal(scale=0.001, size=n)])
        planes.append(prepare_points(points + np.asarray([0, 0, 2]), config=POINTS))
    start = np.eye(4)
    start[:3, 3] = [0.03, -0.02, 0.02]
    result = align(planes[0], planes[1], se3.from_matrix(start))
    assert finite(result)
    np.testing.assert_array_equal(result.free, [True, True, True, False, False, False])
    found = np.asarray(se3.matrix(result.T_target_source), np.float64)
    assert abs(found[:3, 2] @ [0, 0, 2] + found[2, 3] - 2) < 1e-3
    # It stays where it was put along the plane, and does not turn in it.
    middle = found @ [0, 0, 2, 1]
    np.testing.assert_allclose(middle[:2], start[:2, 3], atol=2e-3)
    assert abs(found[1, 0]) < 2e-3
    # The free directions keep the plane's points on the plane.
    for direction in np.asarray(result.directions[:, :3], np.float64).T:
        step = np.asarray(se3.matrix(se3.exp(jnp.asarray(0.01 * direction, jnp.float32))), np.float64)
        for corner in product((-1, 1), (-1, 1), (2,)):
            assert abs(step[2, :3] @ corner + step[2, 3] - 2) < 2e-3


def test_a_prior_holds_what_the_geometry_leaves_free(rng):
    points = np.column_stack([rng.uniform(-1, 1, (COUNT, 2)), rng.normal(scale=0.001, size=COUNT)])
    points[:, 2] += 2
    plane = prepare_points(points, config=POINTS)
    mean = se3.exp(jnp.asarray([0.04, -0.03, 0.2, 0.0, 0.0, 0.0]))
    prior = MotionPrior(mean, jnp.diag(jnp.asarray([1e4, 1e4, 1e-6, 1e4, 1e4, 1e4])))
    result = align(plane, plane, se3.identity(), prior=prior)
    found = np.asarray(se3.matrix(result.T_target_source))
    np.testing.assert_allclose(found[:2, 3], [0.04, -0.03], atol=2e-3)
    assert abs(found[2, 3]) < 2e-3  # the wall outweighs a weak belief
    assert np.sum(result.free) == 3  # which is of the geometry alone


def test_identical_clouds_stay_where_they_are(clouds):
    target, _ = clouds
    result = align(target, target, se3.identity())
    metres, degrees = error(result, np.eye(4))
    assert metres < 1e-5
    assert degrees < 1e-3
    assert result.converged
    assert result.inlier_fraction > 0.999


def test_nothing_to_align_is_not_called_converged(clouds, rng):
    target, _ = clouds
    eight = room(rng)[:8]
    hopeless = {
        "empty": np.zeros((0, 3)),
        "nan": np.full((COUNT, 3), np.nan),
        "eight": eight,
        "far": room(rng) + 50.0,
        "one place": np.zeros((COUNT, 3)),
    }
    start = se3.from_matrix(MOTION)
    for name, points in hopeless.items():
        cloud = prepare_points(points, config=POINTS)
        for result in (align(cloud, target, start), align(target, cloud, start)):
            assert finite(result), name
            assert not result.converged, name
    assert (
        align(prepare_points(eight, config=POINTS), prepare_points(eight, config=POINTS), start).iterations
        >= 0
    )


def test_bad_settings_are_refused():
    points = np.zeros((10, 3))
    with pytest.raises(InputError, match="change k"):
        prepare_points(points, k=2)
    with pytest.raises(InputError, match="above 0"):
        prepare_points(points, config=replace(POINTS, voxel_size=-1.0))
    with pytest.raises(InputError, match="one for each"):
        prepare_gaussians(points, np.zeros((9, 3, 3)))


def test_full_capacities_are_reported(scans):
    cloud = prepare_points(scans[0], config=PointsConfig(levels=1, voxel_size=0.05, max_points=256))
    assert cloud.levels[0].points.shape == (256, 3)
    assert cloud.overflow > 1000


def test_lidar_scans_are_aligned_at_a_voxel_size_fitted_to_them():
    rng = np.random.default_rng(3)
    known = np.asarray(se3.matrix(se3.exp(jnp.asarray([0.6, 0.08, 0.01, 0.004, 0.006, 0.03]))), np.float64)
    scans = [street_scan(T, rng, rings=32, steps=900) for T in (np.eye(4), known)]
    target, source = (prepare_points(points, config=PointsConfig(levels=2)) for points in scans)
    # Sparse points among dense ones are searched for widely, and nothing is lost by that.
    assert target.overflow == 0
    assert source.overflow == 0
    result = align(source, target, se3.identity())
    metres, degrees = error(result, known)
    assert metres < 0.02
    assert degrees < 0.1
    assert result.converged
