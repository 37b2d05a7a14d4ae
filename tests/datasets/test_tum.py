"""TUM recordings: association, intrinsics, ground truth."""

import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import ReaderOptions, open_recording


@pytest.fixture
def freiburg(tmp_path, write_image, images):
    """Writes a recording with given colour and depth time stamps."""

    def write(colour: list[str], depth: list[str], name: str = "rgbd_dataset_freiburg3_small"):
        folder = tmp_path / name
        for kind, times in (("rgb", colour), ("depth", depth)):
            (folder / kind).mkdir(parents=True)
            for i, time in enumerate(times):
                rgb, units = images(640, 480)
                units[0, 0] = 5000 * (i + 1)
                write_image(folder / kind / f"{time}.png", rgb if kind == "rgb" else units)
            lines = "".join(f"{time} {kind}/{time}.png\n" for time in times)
            (folder / f"{kind}.txt").write_text("# timestamp filename\n" + lines)
        return folder

    return write


def test_colour_and_depth_are_matched_by_time(freiburg):
    folder = freiburg(["10.00", "10.03", "10.06", "10.20"], ["9.991", "10.036", "10.09"])
    recording = open_recording(folder)
    assert recording.timestamps.tolist() == [10.00, 10.03]
    assert "2 of 4 colour images" in recording.notes[0]
    assert float(np.asarray(recording[1].depth)[0, 0]) == pytest.approx(2.0)
    wider = open_recording(folder, options=ReaderOptions(association_limit=0.031))
    assert wider.timestamps.tolist() == [10.00, 10.03, 10.06]


def test_depth_keeps_its_own_time_stamp(freiburg):
    folder = freiburg(["10.00", "10.03", "10.06"], ["9.991", "10.036", "10.09"])
    recording = open_recording(folder, options=ReaderOptions(max_depth=9.0, stride=1))
    assert [(recording[i].timestamp, recording[i].depth_timestamp) for i in range(2)] == [
        (10.00, 9.991),
        (10.03, 10.036),
    ]


def test_intrinsics_by_name(freiburg):
    recording = open_recording(freiburg(["1.0"], ["1.0"]))
    np.testing.assert_allclose(
        [
            float(x)
            for x in (recording.camera.fx, recording.camera.fy, recording.camera.cx, recording.camera.cy)
        ],
        [535.4, 539.2, 320.1, 247.6],
    )
    assert recording.ground_truth is None


def test_without_intrinsics_the_error_says_what_to_write(freiburg):
    folder = freiburg(["1.0"], ["1.0"], name="mine")
    with pytest.raises(InputError, match=r'mine/camera\.json; write one such as {"fx"'):
        open_recording(folder)


def test_ground_truth_is_taken_at_the_colour_images_times(freiburg):
    folder = freiburg(["1.00", "1.10", "1.20"], ["1.00", "1.10", "1.20"])
    rows = ["0.995 0 0 0 0 0 0 1", "1.005 1 0 0 0 0 0 1", "1.11 5 0 0 0 0 0 1", "1.2 nan 0 0 0 0 0 1"]
    (folder / "groundtruth.txt").write_text("\n".join(rows))
    recording = open_recording(folder)
    truth = recording.ground_truth
    assert truth is not None
    assert truth.timestamps.tolist() == [1.00, 1.10]
    np.testing.assert_allclose(truth.positions[:, 0], [0.5, 5.0], atol=1e-9)
    assert recording.notes == (
        "1 ground-truth pose is not finite and ignored.",
        "1 of 3 frames have no ground-truth pose within 0.02 s.",
    )


def test_clocks_that_do_not_match_are_refused(freiburg):
    with pytest.raises(InputError, match="one clock"):
        open_recording(freiburg(["1.0"], ["500.0"]))


def test_line_that_is_no_pair_is_refused(freiburg):
    folder = freiburg(["1.0"], ["1.0"])
    (folder / "rgb.txt").write_text("# comment\nrgb/1.0.png\n")
    with pytest.raises(InputError, match=r"rgb\.txt, line 2"):
        open_recording(folder)


def test_lists_without_images_are_refused(freiburg):
    folder = freiburg([], [])
    with pytest.raises(InputError, match="No pairs of colour and depth images"):
        open_recording(folder)
