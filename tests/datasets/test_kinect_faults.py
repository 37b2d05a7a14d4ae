"""A Kinect's faults in synthetic recordings: each alone does what it says, and the truth stays exact."""

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import ArrayLike

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import KINECT_V1, KinectFaults, SyntheticRecording, open_recording
from sfgs_jax.datasets.synthetic import IdealView, poses_between, render_view
from sfgs_jax.geometry import Trajectory, se3

# One size for all: each compiles anew. On the way aside and back, frame 8 of 30 is in full swing.
HEIGHT, WIDTH, FRAME = 72, 96, 8


def _recording(faults: KinectFaults | None = None, **settings) -> SyntheticRecording:
    return SyntheticRecording(num_frames=30, width=WIDTH, height=HEIGHT, faults=faults, **settings)


@pytest.fixture(scope="module")
def ideal() -> SyntheticRecording:
    return _recording()


def _seen_at(recording: SyntheticRecording, time: float, T_cam_sensor: np.ndarray | None = None) -> IdealView:
    """The view of an ideal camera at a time."""
    pose = recording.poses_at(np.asarray([time]))[0] @ (np.eye(4) if T_cam_sensor is None else T_cam_sensor)
    return render_view(recording.scene, recording.camera, se3.from_matrix(pose))


def _assert_same_depth(got: ArrayLike, expected: ArrayLike) -> None:
    """Equal to float32; but a ray along an edge may fall to either side of it."""
    close = np.abs(np.asarray(got) - np.asarray(expected)) < 1e-5 * np.asarray(expected)
    assert close.mean() > 0.998


def test_without_faults_images_are_ideal_to_the_last_bit(ideal):
    expected = render_view(ideal.scene, ideal.camera, se3.from_matrix(ideal.ground_truth.poses[FRAME]))
    for faults in (None, KinectFaults(), KinectFaults(gain_period=1.0)):
        frame = _recording(faults)[FRAME]
        np.testing.assert_array_equal(frame.rgb, expected.rgb)
        np.testing.assert_array_equal(frame.depth, expected.depth)
        assert frame.depth_timestamp == frame.timestamp


def test_rows_of_a_camera_at_rest_are_the_ideal_images():
    # A single frame has a single pose at all times.
    room = SyntheticRecording(
        width=WIDTH, height=HEIGHT, num_frames=1, faults=KinectFaults(colour_readout=0.03, depth_readout=0.03)
    )
    view = _seen_at(room, 0.0)
    _assert_same_depth(room[0].depth, view.depth)
    error = np.abs(np.asarray(room[0].rgb) - np.asarray(view.rgb))
    assert np.median(error) < 1e-6
    assert np.mean(error > 1e-4) < 0.01


def test_poses_are_exact_at_frames_and_smooth_between(ideal):
    faulty = _recording(KINECT_V1)
    np.testing.assert_array_equal(faulty.ground_truth.poses, ideal.ground_truth.poses)
    np.testing.assert_allclose(faulty.poses_at(faulty.timestamps), ideal.ground_truth.poses, atol=1e-12)
    # From every second pose, the others follow.
    truth = ideal.ground_truth
    half = Trajectory(truth.timestamps[::2], truth.poses[::2])
    between = se3.matrices_of(poses_between(half, truth.timestamps[7:22:2], np.eye(4)))
    np.testing.assert_allclose(between, truth.poses[7:22:2], atol=5e-4)


def test_quaternions_that_change_sign_make_no_jump():
    angles = np.linspace(0, 4 * np.pi, 200)
    poses = np.tile(np.eye(4), (200, 1, 1))
    poses[:, :2, :2] = np.moveaxis(
        np.asarray([[np.cos(angles), -np.sin(angles)], [np.sin(angles), np.cos(angles)]]), -1, 0
    )
    got = se3.matrices_of(poses_between(Trajectory(angles, poses), (angles[1:] + angles[:-1]) / 2, np.eye(4)))
    np.testing.assert_allclose(got[:, 0, 0], np.cos((angles[1:] + angles[:-1]) / 2), atol=1e-5)


@pytest.mark.parametrize("delay", [0.015, -0.01])
def test_late_depth_is_depth_at_the_later_pose(ideal, delay):
    room = _recording(KinectFaults(depth_delay=delay))
    frame = room[FRAME]
    assert frame.depth_timestamp == pytest.approx(frame.timestamp + delay, abs=1e-12)
    np.testing.assert_allclose(room.depth_timestamps, room.timestamps + delay)
    _assert_same_depth(frame.depth, _seen_at(room, float(frame.timestamp) + delay).depth)
    assert np.mean(np.abs(np.asarray(frame.depth) - ideal[FRAME].depth) > 0.01) > 0.3
    assert np.median(np.abs(np.asarray(frame.rgb) - ideal[FRAME].rgb)) < 1e-6


def test_rows_of_depth_are_seen_one_after_the_other(ideal):
    room = _recording(KinectFaults(depth_readout=0.03))
    frame = room[FRAME]
    for row in (0, 17, 35, 71):
        time = frame.timestamp + 0.03 * (row / (HEIGHT - 1) - 0.5)
        _assert_same_depth(frame.depth[row], np.asarray(_seen_at(room, time).depth)[row])
    # The first and the last row have moved, the middle ones hardly.
    moved = np.median(np.abs(np.asarray(frame.depth) - ideal[FRAME].depth), axis=1)
    assert min(moved[:5].mean(), moved[-5:].mean()) > 5 * moved[34:38].mean()
    assert np.median(np.abs(np.asarray(frame.rgb) - ideal[FRAME].rgb)) < 1e-6


def test_rows_of_colour_are_seen_one_after_the_other(ideal):
    room = _recording(KinectFaults(colour_readout=0.03))
    frame = room[FRAME]
    for row in (0, 17, 54, 71):
        time = frame.timestamp + 0.03 * (row / (HEIGHT - 1) - 0.5)
        expected = np.asarray(_seen_at(room, time).rgb)[row]
        error = np.abs(frame.rgb[row] - expected).mean()
        # Corners of pixels lie between rows, and so do their times.
        assert error < 0.003
        assert np.abs(ideal[FRAME].rgb[row] - expected).mean() > 5 * error
    _assert_same_depth(frame.depth, ideal[FRAME].depth)


def test_blur_is_the_mean_over_the_exposure(ideal):
    exposure = 0.02
    room = _recording(KinectFaults(exposure_time=exposure))
    blurred = np.asarray(room[FRAME].rgb, np.float64)
    time = room.timestamps[FRAME]
    instants = time + exposure * np.asarray([-0.4, -0.2, 0.0, 0.2, 0.4])
    expected = np.mean([np.asarray(_seen_at(room, t).rgb) for t in instants], axis=0)
    assert np.median(np.abs(blurred - expected)) < 1e-6
    assert np.abs(blurred - expected).mean() < 1e-4
    assert np.abs(blurred - ideal[FRAME].rgb).mean() > 0.01
    _assert_same_depth(room[FRAME].depth, ideal[FRAME].depth)


def test_blur_is_as_wide_as_the_motion_during_the_exposure(ideal):
    exposure = 0.006
    time = ideal.timestamps[FRAME]
    blurred = np.asarray(_recording(KinectFaults(exposure_time=exposure))[FRAME].rgb, np.float64)
    # The mean over a box of width w adds w² / 24 times the second derivative along the motion. It is taken
    # from differences over this step, whose error in the fourth derivative is that of the box.
    step = exposure * (12 / 80) ** 0.5
    before, middle, after = (
        np.asarray(_seen_at(ideal, t).rgb, np.float64) for t in (time - step, time, time + step)
    )
    second = (before - 2 * middle + after) / step**2
    smooth = np.abs(second) < np.percentile(np.abs(second), 80)  # at the edges of things there is none
    width = np.sqrt(24 * np.sum(((blurred - middle) * second)[smooth]) / np.sum(second[smooth] ** 2))
    # Five instants have 24/25 of the box's variance.
    assert width == pytest.approx(exposure * (24 / 25) ** 0.5, rel=0.05)


def test_gain_is_a_slow_sinusoid(ideal):
    room = _recording(KinectFaults(gain_amplitude=0.2, gain_period=1.0))
    assert room.gains[0] == 1
    assert room.gains.max() == pytest.approx(1.2, abs=0.01)
    assert room.gains.min() == pytest.approx(0.8, abs=0.01)
    for i in (7, 22):
        before = np.asarray(ideal[i].rgb)
        unclipped = (before > 0.1) & (before < 0.8)
        ratio = (np.asarray(room[i].rgb) / np.maximum(before, 0.1))[unclipped]
        assert np.median(ratio) == pytest.approx(room.gains[i], abs=1e-4)
        assert np.asarray(room[i].rgb).max() <= 1
        _assert_same_depth(room[i].depth, ideal[i].depth)


def test_bands_are_bounded_smooth_vertical_and_the_cameras_own(ideal):
    room = _recording(KinectFaults(depth_bands=0.010))
    offsets = room.inverse_depth_offsets
    at_two_metres = 1 / (1 / 2.0 + offsets) - 2.0
    assert np.abs(at_two_metres).max() == pytest.approx(0.010, rel=0.01)
    assert np.ptp(at_two_metres) > 0.012
    # Vertical: colour changes across far more than along.
    across, down = (np.abs(np.diff(offsets, axis=axis)).mean() for axis in (1, 0))
    assert across > 3 * down
    assert across < 0.1 * np.abs(offsets).max()
    for i in (3, 20):
        z = np.asarray(ideal[i].depth, np.float64)
        measured = 1 / np.asarray(room[i].depth, np.float64) - 1 / z
        assert np.mean(np.abs(measured - offsets) < 1e-6) > 0.998
        assert np.median(np.abs(np.asarray(room[i].rgb) - ideal[i].rgb)) < 1e-6
    other = _recording(KinectFaults(depth_bands=0.010), seed=1).inverse_depth_offsets
    assert np.abs(other - offsets).max() > 0.001


def test_extrinsic_error_moves_the_depth_camera(ideal):
    room = _recording(KinectFaults(extrinsic_shift=0.02, extrinsic_turn=0.01))
    T = room.T_colour_depth
    assert np.linalg.norm(T[:3, 3]) == pytest.approx(0.02)
    assert np.arccos((np.trace(T[:3, :3]) - 1) / 2) == pytest.approx(0.01, rel=1e-4)
    frame = room[FRAME]
    _assert_same_depth(frame.depth, _seen_at(room, frame.timestamp, T).depth)
    assert np.median(np.abs(np.asarray(frame.rgb) - ideal[FRAME].rgb)) < 1e-6
    # Points of depth, moved by it, lie where the colour camera sees a surface.
    camera = room.camera
    points = np.asarray(camera.unproject(camera.pixels(), jnp.asarray(frame.depth)), np.float64).reshape(
        -1, 3
    )
    points = points @ T[:3, :3].T + T[:3, 3]
    pixels = np.round(np.asarray(camera.project(jnp.asarray(points, jnp.float32)))).astype(int)
    inside = np.all((pixels >= 0) & (pixels < (WIDTH, HEIGHT)), axis=1)
    depth = np.asarray(ideal[FRAME].depth)[pixels[inside, 1], pixels[inside, 0]]
    assert np.median(np.abs(depth - points[inside, 2])) < 0.01
    np.testing.assert_allclose(ideal.T_colour_depth, np.eye(4), atol=1e-12)


def test_noise_comes_on_top():
    steady, noisy = _recording(KINECT_V1)[FRAME], _recording(KINECT_V1, noise=True)[FRAME]
    z, got = np.asarray(steady.depth), np.asarray(noisy.depth)
    assert 0.002 < np.mean(got == 0) < 0.3
    sigma = 0.0012 + 0.0019 * (z - 0.4) ** 2
    assert 0.6 < np.median((np.abs(got - z) / sigma)[got > 0]) / 0.6745 < 1.6
    assert np.std(noisy.rgb - steady.rgb) == pytest.approx(0.008, rel=0.15)


def test_source_string_asks_for_a_kinect():
    kinect = SyntheticRecording.parse(f"synthetic:kinect=1,frames=30,width={WIDTH},height={HEIGHT}")
    assert kinect == _recording(KINECT_V1, noise=True)
    assert not SyntheticRecording.parse("synthetic:kinect=1,noise=0,frames=2").noise
    assert SyntheticRecording.parse("synthetic:kinect=0,frames=2").faults is None
    recording = open_recording(f"synthetic:kinect=1,frames=30,width={WIDTH},height={HEIGHT}")
    frame = recording[FRAME]
    assert frame.depth_timestamp == pytest.approx(frame.timestamp + 0.015)
    np.testing.assert_array_equal(frame.depth, kinect[FRAME].depth)


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("depth_bands", -0.01),
        ("depth_delay", float("nan")),
        ("colour_readout", 0.05),
        ("exposure_time", "20 ms"),
        ("gain_amplitude", 1.0),
        ("gain_period", 0.0),
        ("extrinsic_turn", 3.0),
    ],
)
def test_settings_without_meaning_are_refused(setting, value):
    with pytest.raises((InputError, TypeError), match=setting):
        KinectFaults(**{setting: value})
