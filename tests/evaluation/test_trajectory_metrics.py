import logging

import numpy as np
import pytest
from evo.core import metrics as evo_metrics
from evo.core import sync as evo_sync
from evo.core.trajectory import PoseTrajectory3D

from sfgs_jax.arrays import InputError
from sfgs_jax.evaluation import align_points, ate, rpe
from sfgs_jax.geometry import Trajectory, read_tum, rotations_from_quaternions

logging.getLogger("evo").setLevel(logging.ERROR)


def _random_walk(rng: np.random.Generator, n: int) -> Trajectory:
    """Small random motions chained into a path."""
    poses = np.tile(np.eye(4), (n, 1, 1))
    steps = np.tile(np.eye(4), (n, 1, 1))
    wxyz = np.concatenate([np.ones((n, 1)), 0.05 * rng.normal(size=(n, 3))], axis=1)
    steps[:, :3, :3] = rotations_from_quaternions(wxyz)
    steps[:, :3, 3] = 0.03 * rng.normal(size=(n, 3)) + [0.02, 0, 0]
    for i in range(1, n):
        poses[i] = poses[i - 1] @ steps[i]
    return Trajectory(np.arange(n) / 30 + 1305031225.0, poses)


def _disturbed(rng: np.random.Generator, trajectory: Trajectory, size: float) -> Trajectory:
    """The same path in another world frame, with noise on every pose."""
    n = len(trajectory)
    noise = np.tile(np.eye(4), (n, 1, 1))
    noise[:, :3, :3] = rotations_from_quaternions(
        np.concatenate([np.ones((n, 1)), size * rng.normal(size=(n, 3))], axis=1)
    )
    noise[:, :3, 3] = size * rng.normal(size=(n, 3))
    T = np.eye(4)
    T[:3, :3] = rotations_from_quaternions(rng.normal(size=(1, 4)))[0]
    T[:3, 3] = [1.0, -2.0, 3.0]
    return Trajectory(trajectory.timestamps, T @ trajectory.poses @ noise)


def _evo(trajectory: Trajectory) -> PoseTrajectory3D:
    return PoseTrajectory3D(poses_se3=list(trajectory.poses), timestamps=trajectory.timestamps)


def _evo_errors(estimate: Trajectory, reference: Trajectory, *, with_scale=False):
    """ATE statistics and RPE of evo, SE(3)- or Sim(3)-aligned, one frame apart, all pairs."""
    ref, est = evo_sync.associate_trajectories(_evo(reference), _evo(estimate), max_diff=0.02)
    relative = []
    for relation in (evo_metrics.PoseRelation.translation_part, evo_metrics.PoseRelation.rotation_angle_deg):
        metric = evo_metrics.RPE(relation, delta=1, delta_unit=evo_metrics.Unit.frames, all_pairs=True)
        metric.process_data((ref, est))
        relative.append(metric.get_statistic(evo_metrics.StatisticsType.rmse))
    est.align(ref, correct_scale=with_scale)
    absolute = evo_metrics.APE(evo_metrics.PoseRelation.translation_part)
    absolute.process_data((ref, est))
    return absolute.get_all_statistics(), relative


def _assert_agrees(estimate: Trajectory, reference: Trajectory, *, with_scale=False) -> None:
    absolute, (trans, rot) = _evo_errors(estimate, reference, with_scale=with_scale)
    ours = ate(estimate, reference, with_scale=with_scale)
    assert ours.rmse_m == pytest.approx(absolute["rmse"], abs=1e-6)
    assert ours.mean_m == pytest.approx(absolute["mean"], abs=1e-6)
    assert ours.median_m == pytest.approx(absolute["median"], abs=1e-6)
    assert ours.max_m == pytest.approx(absolute["max"], abs=1e-6)
    relative = rpe(estimate, reference)
    assert relative.trans_m == pytest.approx(trans, abs=1e-6)
    assert relative.rot_deg == pytest.approx(rot, abs=1e-6)


@pytest.mark.parametrize("with_scale", [False, True])
@pytest.mark.parametrize("seed", [0, 1])
def test_random_trajectories_agree_with_evo(seed, with_scale):
    rng = np.random.default_rng(seed)
    reference = _random_walk(rng, 80)
    _assert_agrees(_disturbed(rng, reference, 0.05), reference, with_scale=with_scale)


def test_real_trajectory_with_time_offsets_agrees_with_evo(sfgs_data, rng):
    """100 Hz ground truth against poses at the colour images' own times, some of them lost."""
    folder = sfgs_data / "data/tum/rgbd_dataset_freiburg1_rpy"
    reference = read_tum(folder / "groundtruth.txt")
    times = np.loadtxt(folder / "rgb.txt", usecols=0)
    times = np.delete(times, [10, 11, 50, 200])
    nearest = reference[np.abs(reference.timestamps - times[:, None]).argmin(axis=1)]
    estimate = _disturbed(rng, Trajectory(times, nearest.poses), 0.02)
    _assert_agrees(estimate, reference)
    assert ate(estimate, reference).num_pairs == len(times)


def test_exact_estimate_in_another_world_has_no_error(rng):
    reference = _random_walk(rng, 30)
    estimate = _disturbed(rng, reference, 0.0)
    result = ate(estimate, reference)
    assert result.max_m < 1e-9
    np.testing.assert_allclose(result.T_reference_estimate @ estimate.poses, reference.poses, atol=1e-9)
    np.testing.assert_allclose(result.alignment.transform_poses(estimate).poses, reference.poses, atol=1e-9)
    assert rpe(estimate, reference, delta=5).rot_deg < 1e-6


def test_scale_is_recovered_only_on_request(rng):
    reference = _random_walk(rng, 30)
    half = Trajectory(reference.timestamps, reference.poses.copy())
    half.poses[:, :3, 3] /= 2
    assert ate(half, reference, with_scale=True).rmse_m < 1e-9
    assert ate(half, reference, with_scale=True).alignment.scale == pytest.approx(2)
    assert ate(half, reference).rmse_m > 0.05


def test_relative_error_of_a_known_motion():
    """One step of 10 cm and 2 degrees where there should be none: 4 of 5 motions are exact."""
    reference = Trajectory(np.arange(6.0), np.tile(np.eye(4), (6, 1, 1)))
    poses = reference.poses.copy()
    angle = np.radians(2)
    poses[3:, :2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    poses[3:, 0, 3] = 0.1
    result = rpe(Trajectory(reference.timestamps, poses), reference)
    assert result.num_pairs == 5
    assert result.trans_m == pytest.approx(np.sqrt(0.1**2 / 5))
    assert result.rot_deg == pytest.approx(np.sqrt(2**2 / 5))


def test_order_in_the_files_does_not_matter(rng):
    reference = _random_walk(rng, 20)
    estimate = _disturbed(rng, reference, 0.05)
    shuffled = rng.permutation(20)
    assert ate(estimate[shuffled], reference).rmse_m == pytest.approx(ate(estimate, reference).rmse_m)
    assert rpe(estimate, reference[shuffled]) == rpe(estimate, reference)


def test_points_on_a_line_have_a_defined_error(rng):
    """Rotation about the line is open; the error isn't, and the answer is still a rotation."""
    x = np.linspace(0, 1, 12)[:, None] * np.array([[1.0, 2.0, -1.0]])
    y = np.linspace(0, 1, 12)[:, None] * np.array([[0.0, np.sqrt(6), 0.0]]) + 4.0
    alignment = align_points(x, y)
    rotation = alignment.T_target_source[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
    np.testing.assert_allclose(alignment.transform(x), y, atol=1e-12)


def test_a_camera_that_stands_still_has_a_defined_error():
    still = Trajectory(np.arange(5.0), np.tile(np.eye(4), (5, 1, 1)))
    result = ate(still, still, with_scale=True)
    assert result.rmse_m == 0
    assert result.alignment.scale == 1


def test_too_few_pairs_are_refused(rng):
    walk = _random_walk(rng, 10)
    with pytest.raises(InputError, match=r"Only 2 of 2 .* 3 are needed"):
        ate(walk[:2], walk)
    later = Trajectory(walk.timestamps + 100, walk.poses)
    with pytest.raises(InputError, match="Only 0 of 10"):
        rpe(later, walk)
    with pytest.raises(InputError, match="at least 1"):
        rpe(walk, walk, delta=0)
