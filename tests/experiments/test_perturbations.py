"""Each perturbation does what its name says, by numbers, and leaves everything else as it was."""

import numpy as np
import pytest

from experiments.perturbations import PERTURBATIONS, Perturbed, Severity, calibration, light, stream
from experiments.perturbations.colour import COLOUR, fractal_noise
from experiments.perturbations.depth import DEPTH
from experiments.perturbations.recording import true_poses
from experiments.starts import InMemory
from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import Recording, SyntheticRecording
from sfgs_jax.geometry import Frame

NUM_FRAMES = 60
STEP_AT = 30
"""Frame from which the half of the flat image is bright."""


@pytest.fixture(scope="module")
def recording():
    return InMemory(SyntheticRecording(num_frames=NUM_FRAMES, width=32, height=24))


def perturbed(recording: Recording, name: str, severity: Severity = 3) -> Perturbed:
    return PERTURBATIONS[name].apply(recording, severity, 0)


def flat(value=0.5, height=60, width=80):
    return np.full((height, width, 3), value, np.float32)


def change(name, image, severity, seed=0):
    kind = {**COLOUR, **DEPTH}[name]
    return kind.apply(image, np.random.default_rng(seed), kind.parameters[severity - 1])


@pytest.mark.parametrize("name", PERTURBATIONS)
def test_every_one_is_a_recording_that_repeats_itself(recording, name):
    for severity in PERTURBATIONS[name].severities:
        found, again = (perturbed(recording, name, severity) for _ in range(2))
        assert isinstance(found, Recording)
        assert len(found.timestamps) == len(found.poses) == len(found.disturbed) == len(found)
        assert found.ground_truth is not None
        assert len(found.ground_truth) == len(found)
        for number in (0, len(found) // 2, len(found) - 1):
            frame, twin = found[number], again[number]
            assert isinstance(frame, Frame)
            assert frame.rgb.dtype == frame.depth.dtype == np.float32
            assert frame.rgb.min() >= 0
            assert frame.rgb.max() <= 1
            assert frame.depth.min() >= 0
            np.testing.assert_array_equal(frame.rgb, twin.rgb)
            np.testing.assert_array_equal(frame.depth, twin.depth)


@pytest.mark.parametrize("name", COLOUR)
def test_those_of_colour_leave_depth_alone_and_grow_with_severity(recording, name):
    off = []
    for severity in (1, 3, 5):
        frame, before = perturbed(recording, name, severity)[20], recording[20]
        np.testing.assert_array_equal(frame.depth, before.depth)
        off.append(float(np.abs(frame.rgb - before.rgb).mean()))
    assert 0 < off[0] < off[2]
    assert off[1] > 0.9 * off[0]


def test_dynamic_draws_a_severity_for_each_frame(recording):
    found = perturbed(recording, "brightness", "dynamic")
    added = [np.median(found[n].rgb.max(2) - recording[n].rgb.max(2)) for n in range(20)]
    assert set(np.round(10 * np.asarray(added)).astype(int)) == {1, 2, 3, 4, 5}


def test_noise_has_the_published_strength():
    assert np.std(change("gaussian noise", flat(), 3)) == pytest.approx(0.18, rel=0.02)
    assert np.var(change("shot noise", flat(), 5)) == pytest.approx(0.5 / 3, rel=0.05)
    assert np.std(change("speckle noise", flat(), 1)) == pytest.approx(0.5 * 0.15, rel=0.02)
    salt = change("impulse noise", flat(), 5)
    assert np.mean(salt != 0.5) == pytest.approx(0.27, abs=0.01)
    assert set(np.unique(salt)) == {0, np.float32(0.5), 1}


def test_blurs_spread_a_point_as_far_as_they_say():
    point = flat(0.0, 81, 81)
    point[40, 40] = 1
    v, u = np.mgrid[-40:41, -40:41]

    def moments(image):
        weight = image[..., 0] / image[..., 0].sum()
        return (weight * u).sum(), (weight * v).sum(), np.sqrt((weight * (u**2 + v**2)).sum())

    for name in ("gaussian blur", "defocus", "motion blur"):
        assert change(name, point, 3)[..., 0].sum() == pytest.approx(1, abs=1e-3)
    assert moments(change("gaussian blur", point, 5))[2] == pytest.approx(6 * np.sqrt(2), rel=0.01)
    # A disc of radius R has the mean square distance R^2 / 2.
    assert moments(change("defocus", point, 5))[2] == pytest.approx(10 / np.sqrt(2), rel=0.02)
    blurred = change("motion blur", point, 5)[..., 0]
    right, down, _ = moments(change("motion blur", point, 5))
    assert abs(right) > 10
    assert abs(down) <= 1.05 * abs(right)
    assert 35 <= np.count_nonzero(blurred > 1e-6) <= 41
    moved = change("glass blur", point, 1)[..., 0]
    assert moved[34:47, 34:47].sum() > 0.98 * moved.sum()


def test_light_and_coding():
    ramp = np.repeat(np.linspace(0.1, 0.4, 80, dtype=np.float32)[None, :, None], 60, 0).repeat(3, 2)
    np.testing.assert_allclose(change("brightness", ramp, 5), ramp + 0.5, atol=1e-5)
    found = change("contrast", ramp, 4)
    assert found.std() == pytest.approx(0.1 * ramp.std(), rel=1e-3)
    assert found.mean() == pytest.approx(ramp.mean(), rel=1e-3)
    assert len(np.unique(change("pixelate", ramp, 5)[0, :, 0])) == 20
    step = flat(0.2)
    step[:, STEP_AT:] = 0.8
    coded = change("jpeg", step, 5)
    assert 0.005 < np.abs(coded - step).mean() < 0.05
    foggy = change("fog", ramp, 3)
    assert foggy.max() <= ramp.max() + 1e-5
    assert foggy.mean() > ramp.mean() * 0.5
    assert change("snow", ramp, 3).mean() > ramp.mean() + 0.1
    rough, smooth = (
        np.abs(np.diff(fractal_noise((64, 64), np.random.default_rng(0), decay))).mean() for decay in (1.4, 2)
    )
    assert rough > 1.2 * smooth


def test_depth_faults():
    depth = np.full((60, 80), 2.0, np.float32)
    depth[:, 40:] = 4.0
    depth[:10] = 0
    noisy = change("depth noise", depth, 1)
    known = depth > 0
    assert (noisy[~known] == 0).all()
    assert (noisy - depth)[known].mean() == pytest.approx(0.1 * 3, rel=0.03)
    assert (noisy - depth)[known].std() == pytest.approx(0.1 * 1, rel=0.05)
    eroded = change("depth edges", depth, 5)
    gone = known & (eroded == 0)
    # The edge between the halves, the one to the missing rows, and some holes; no other depth changes.
    assert 100 < gone.sum() < 1000
    np.testing.assert_array_equal(eroded[~gone], depth[~gone])
    assert not gone[20:, :30].any()
    full = np.full((60, 80), 2.0, np.float32)
    # One mask has a hundredth of the image, and masks overlap.
    assert 0.08 < np.mean(change("depth random masks", full, 3) == 0) <= 0.2
    assert not np.array_equal(*(change("depth random masks", full, 3, seed) for seed in range(2)))
    assert 0.06 < np.mean(change("depth fixed masks", full, 3) == 0) <= 0.09
    np.testing.assert_array_equal(*(change("depth fixed masks", full, 3, seed) for seed in range(2)))
    row = np.array([[0.1, 0.5, 1.0, 3.7, 3.9, 4.3, 5.0]], np.float32)
    np.testing.assert_array_equal(
        change("depth range", row, 4), np.array([[0, 0.5, 1, 3.7, 0, 0, 0]], np.float32)
    )


def test_exposure_follows_the_light():
    gains = light.gains(90, 2.0)
    np.testing.assert_allclose(gains[:30], 1)
    assert gains[30] == pytest.approx(4)
    assert np.log2(gains[40]) == pytest.approx(2 * np.exp(-1))
    assert gains[60] < 0.3
    assert np.all(np.diff(gains[30:60]) < 0)


def test_frames_that_do_not_arrive(recording):
    found = perturbed(recording, "every k-th frame", 3)
    np.testing.assert_array_equal(found.timestamps, recording.timestamps[::4])
    found = perturbed(recording, "dropped frames", 5)
    assert 20 <= len(found) <= 40
    assert found.timestamps[0] == recording.timestamps[0]
    kept = np.isin(recording.timestamps, found.timestamps)
    np.testing.assert_array_equal(found.poses, true_poses(recording)[kept])
    np.testing.assert_array_equal(found[5].rgb, recording[int(np.flatnonzero(kept)[5])].rgb)


def test_images_that_stay(recording):
    found = perturbed(recording, "frozen frames", 1)
    np.testing.assert_array_equal(found.colours[28:36], [28, 29, 30, 30, 30, 33, 34, 35])
    np.testing.assert_array_equal(found.timestamps, recording.timestamps)
    np.testing.assert_array_equal(found[32].rgb, recording[30].rgb)
    np.testing.assert_array_equal(found.poses[32], true_poses(recording)[30])
    found = perturbed(recording, "duplicated frames", 3)
    repeated = np.flatnonzero(np.diff(found.colours) == 0)
    assert 10 <= len(repeated) <= 26
    assert (np.diff(found.colours) >= 0).all()
    assert (np.arange(NUM_FRAMES) - found.colours).max() <= 5


@pytest.mark.parametrize(("name", "has_depth"), [("black frames", True), ("black, no depth", False)])
def test_black_frames(recording, name, has_depth):
    found = perturbed(recording, name, 3)
    dark = [n for n in range(NUM_FRAMES) if not found[n].rgb.any()]
    assert dark == list(range(30, 40))
    assert all(found[n].depth.any() == has_depth for n in dark)
    np.testing.assert_array_equal(np.flatnonzero(found.disturbed), [] if has_depth else dark)


def test_frames_without_depth(recording):
    found = perturbed(recording, "without depth", 3)
    without = [n for n in range(NUM_FRAMES) if not found[n].depth.any()]
    assert 8 <= len(without) <= 28
    assert all(found[n].rgb.any() for n in without)


def test_frames_out_of_order_keep_their_times(recording):
    found = perturbed(recording, "out of order", 3)
    assert sorted(found.timestamps) == list(recording.timestamps)
    back = np.diff(found.timestamps) < 0
    assert 5 <= back.sum() <= 25
    np.testing.assert_array_equal(found.timestamps, recording.timestamps[found.colours])


def test_a_camera_that_is_carried_away(recording):
    found = perturbed(recording, "gap", 3)
    np.testing.assert_array_equal(found.colours, [*range(30), *range(50, 60)])
    assert np.diff(found.timestamps).max() == pytest.approx(21 / 30)
    found = perturbed(recording, "kidnapped", 3)
    np.testing.assert_array_equal(found.colours, [*range(30), *range(50, 60), *range(30, 60)])
    np.testing.assert_allclose(np.diff(found.timestamps), 1 / 30)
    np.testing.assert_array_equal(found[45].rgb, recording[35].rgb)


def test_depth_of_another_time_has_the_time_of_colour(recording):
    frame = perturbed(recording, "late depth", 3)[20]
    np.testing.assert_array_equal(frame.rgb, recording[20].rgb)
    np.testing.assert_array_equal(frame.depth, recording[17].depth)
    assert frame.timestamp == recording[20].timestamp
    assert frame.depth_timestamp is None
    walk = perturbed(recording, "late depth", "dynamic")
    delay = walk.colours - walk.depths
    assert set(np.abs(np.diff(delay[10:50]))) == {1}


def test_a_camera_that_is_not_known_well(recording):
    found = perturbed(recording, "wrong intrinsics", 1)
    assert float(found.camera.fx / recording.camera.fx) == pytest.approx(1.01)
    assert float(
        perturbed(recording, "wrong intrinsics", 5).camera.fy / recording.camera.fy
    ) == pytest.approx(1.05)
    assert float(found.camera.cx) == float(recording.camera.cx)
    np.testing.assert_array_equal(found[3].depth, recording[3].depth)
    for number, factor in ((10, 1.05), (40, 1.05)):
        found = perturbed(recording, "wrong depth scale", 5)[number]
        np.testing.assert_allclose(found.depth, factor * recording[number].depth, rtol=1e-6)
    for number, factor in ((10, 1.0), (40, 1.05)):
        found = perturbed(recording, "change of depth scale", 5)[number]
        np.testing.assert_allclose(found.depth, factor * recording[number].depth, rtol=1e-6)


def test_severities_are_1_to_5(recording):
    for apply in (stream.gap, calibration.wrong_scale, light.exposure):
        for severity in (0, 6, "dynamic"):
            with pytest.raises(InputError, match="severities 1 to 5"):
                apply(recording, severity, 0)


def test_poses_that_are_not_known_are_nan(recording):
    class Partly(SyntheticRecording):
        @property
        def ground_truth(self):
            return super().ground_truth[3:]

    found = perturbed(Partly(num_frames=6, width=32, height=24), "none", 1)
    assert np.isnan(found.poses[:3]).all()
    assert found.ground_truth is not None
    assert len(found.ground_truth) == 3
