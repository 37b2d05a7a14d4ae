"""`check_recording` names each fault of a recording, and finds none in a good one."""

import json
import shutil

import cv2
import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import ReaderOptions, SyntheticRecording, open_recording, write_recording
from sfgs_jax.evaluation.recording_check import check_recording
from sfgs_jax.geometry import Frame

NUM_FRAMES = 40


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """A plain folder with a good recording."""
    folder = tmp_path_factory.mktemp("recordings") / "room"
    write_recording(SyntheticRecording(num_frames=NUM_FRAMES, width=80, height=60), folder, layout="folder")
    return folder


@pytest.fixture
def copy(good, tmp_path):
    """A copy that a test may damage."""
    return shutil.copytree(good, tmp_path / "copy")


def check(folder):
    """The findings on a folder by their questions, and the names of those that warn."""
    found = check_recording(open_recording(folder))
    by_question = {finding.question: finding for finding in found.findings}
    assert len(by_question) == len(found.findings)
    for finding in found.findings:
        assert finding.message[0].isupper() or finding.message[0].isdigit()
        assert finding.message.endswith(".")
        assert bool(finding.advice) == (finding.severity == "warning"), finding
    return by_question, [finding.question for finding in found.warnings]


def set_camera(folder, **changes):
    path = folder / "camera.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


def change_images(folder, kind, change):
    for path in (folder / kind).iterdir():
        assert cv2.imwrite(str(path), change(cv2.imread(str(path), cv2.IMREAD_UNCHANGED)))


def change_poses(folder, change):
    path = folder / "poses.txt"
    poses = np.loadtxt(path).reshape(-1, 4, 4)
    np.savetxt(path, np.stack([change(pose) for pose in poses]).reshape(-1, 16))


def test_a_good_recording_has_no_warning_and_nothing_open(good):
    findings, warnings = check(good)
    assert warnings == []
    assert {finding.severity for finding in findings.values()} == {"good"}
    assert {"depth scale", "depth layout", "synchronisation", "poses", "intrinsics", "blur"} <= set(findings)
    assert abs(findings["synchronisation"].evidence["frames late"]) < 0.3
    assert findings["depth scale"].evidence["depth per pose"] == pytest.approx(1, abs=0.05)
    assert findings["intrinsics"].evidence["focal factor"] == pytest.approx(1, abs=0.04)
    assert findings["poses"].evidence["unexplained share of motion"] < 0.1


@pytest.mark.parametrize(
    ("depth_scale", "ratio"), [(200, 5), (5000, 0.2), (1e6, 1e-3), (1, 1000), (655.35, 1.53)]
)
def test_a_wrong_depth_scale_is_told_by_the_poses(copy, depth_scale, ratio):
    set_camera(copy, depth_scale=depth_scale)
    findings, warnings = check(copy)
    assert warnings == ["depth scale"]
    assert findings["depth scale"].evidence["depth per pose"] == pytest.approx(ratio, rel=0.06)
    if ratio in (5, 0.2, 1e-3, 1000):
        assert f"to 1000; it is {depth_scale:g}" in findings["depth scale"].advice


@pytest.mark.parametrize("depth_scale", [200, 5000, 1e6, 1])
def test_a_wrong_depth_scale_is_told_by_habit_without_poses(copy, depth_scale):
    (copy / "poses.txt").unlink()
    set_camera(copy, depth_scale=depth_scale)
    findings, warnings = check(copy)
    assert warnings == ["depth scale"]
    assert f"to 1000; it is {depth_scale:g}" in findings["depth scale"].advice


def test_poses_in_millimetres_are_not_blamed_on_depth(copy):
    change_poses(copy, lambda pose: pose * np.array([[1, 1, 1, 1000]] * 3 + [[1, 1, 1, 1]]))
    findings, warnings = check(copy)
    assert warnings == ["depth scale"]
    assert findings["depth scale"].advice.startswith("Give the poses in metres")


@pytest.mark.parametrize(
    ("change", "name"),
    [
        (lambda image: image[:, ::-1], "mirrored left to right"),
        (lambda image: image[::-1], "mirrored top to bottom"),
    ],
)
def test_turned_depth_is_named(copy, change, name):
    change_images(copy, "depth", change)
    findings, warnings = check(copy)
    assert warnings == ["depth layout"]
    assert findings["depth layout"].message.startswith(f"Depth is {name} against colour")


class Turned(SyntheticRecording):
    """A recording whose depth is transposed, and then brought to the size of colour."""

    def __getitem__(self, index):
        frame = super().__getitem__(index)
        height, width = np.asarray(frame.depth).shape
        depth = cv2.resize(
            np.ascontiguousarray(frame.depth.T), (width, height), interpolation=cv2.INTER_NEAREST
        )
        return Frame(frame.rgb, depth, frame.timestamp)


def test_transposed_depth_is_named():
    found = check_recording(Turned(num_frames=20, width=160, height=120))
    assert [finding.message[:21] for finding in found.warnings] == ["Depth is transposed a"]


def test_depth_beside_its_colour_is_named(copy):
    change_images(copy, "depth", lambda image: np.roll(image, 4, axis=1))
    findings, warnings = check(copy)
    assert warnings == ["registration"]
    assert findings["registration"].evidence["right px"] == pytest.approx(-4, abs=1)


@pytest.mark.parametrize("late", [3, -2])
def test_depth_out_of_step_is_counted(copy, late):
    files = sorted((copy / "depth").iterdir())
    images = [path.read_bytes() for path in files]
    for place, path in enumerate(files):
        path.write_bytes(images[min(max(place - late, 0), len(files) - 1)])
    findings, warnings = check(copy)
    assert warnings == ["synchronisation"]
    word = "late" if late > 0 else "early"
    assert findings["synchronisation"].message.startswith(f"Depth comes {abs(late)} frames {word}")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda pose: pose @ np.diag([1.0, -1, -1, 1]), "in the camera axes of OpenGL"),
        (np.linalg.inv, "world to camera"),
        (lambda pose: pose @ np.diag([-1.0, -1, 1, 1]) @ np.eye(4)[[1, 2, 0, 3]], "in the axes of ROS"),
    ],
)
def test_poses_of_another_convention_are_named(copy, change, words):
    change_poses(copy, change)
    findings, warnings = check(copy)
    assert warnings == ["poses"]
    assert words in findings["poses"].message


@pytest.mark.parametrize("late", [3, 6])
def test_poses_of_other_times_are_named(copy, late):
    """Also where a smooth motion hides it: three frames late, they still explain most of the motion."""
    lines = (copy / "poses.txt").read_text().splitlines()
    (copy / "poses.txt").write_text("\n".join(lines[:1] * late + lines[:-late]) + "\n")
    findings, warnings = check(copy)
    assert warnings == ["poses"]
    assert findings["poses"].message.startswith(f"Poses come {late} frames late")
    assert (findings["poses"].evidence["unexplained share of motion"] < 0.35) == (late == 3)


def test_a_wrong_focal_length_is_measured_and_not_blamed_on_the_poses(copy):
    camera = json.loads((copy / "camera.json").read_text())
    set_camera(copy, fx=1.25 * camera["fx"], fy=1.25 * camera["fy"])
    findings, warnings = check(copy)
    assert warnings == ["intrinsics"]
    assert findings["intrinsics"].evidence["focal factor"] == pytest.approx(0.8, abs=0.03)


def test_dark_and_blurred_images_are_named(copy):
    change_images(copy, "rgb", lambda image: image // 24)
    assert "exposure" in check(copy)[1]
    change_images(copy, "rgb", lambda image: np.full_like(image, 255) - image)
    assert "exposure" in check(copy)[1]


def test_blur_is_named(copy):
    change_images(copy, "rgb", lambda image: cv2.blur(image, (7, 7)))
    assert "blur" in check(copy)[1]


def test_repeated_depth_and_missing_depth_are_named(copy):
    files = sorted((copy / "depth").iterdir())
    for before, after in zip(files[::2], files[1::2], strict=True):
        shutil.copyfile(before, after)
    assert "repeated images" in check(copy)[1]
    change_images(copy, "depth", lambda image: np.where(np.arange(80) < 70, 0, image).astype(np.uint16))
    assert "depth coverage" in check(copy)[1]


def test_depth_of_8_bits_is_named_and_a_bare_wall_is_not(copy):
    """Both have few different depths, but only a picture has even steps."""
    change_images(copy, "depth", lambda image: np.round(image / 39.2).astype(np.uint16) * 39)
    findings, warnings = check(copy)
    assert warnings == ["depth coverage"]
    assert "even steps" in findings["depth coverage"].message
    wall = SyntheticRecording(num_frames=20, width=80, height=60, place="wall", noise=True)
    found = {finding.question: finding for finding in check_recording(wall).findings}
    assert found["depth coverage"].severity == "good"
    assert found["depth coverage"].evidence["different depths"] < 150


def test_a_still_camera_leaves_questions_open(good, tmp_path):
    """Nothing of motion can be told, and nothing is guessed."""
    still = shutil.copytree(good, tmp_path / "still")
    for kind in ("rgb", "depth"):
        files = sorted((still / kind).iterdir())
        for path in files[1:]:
            shutil.copyfile(files[0], path)
    findings, warnings = check(still)
    assert warnings == []
    for question in ("synchronisation", "intrinsics", "distortion", "poses"):
        assert findings[question].severity == "unknown", question
        assert "be told" in findings[question].message


def test_unreadable_images_are_counted_and_none_at_all_refused(copy):
    files = sorted((copy / "rgb").iterdir())
    for path in files[10:16]:
        path.write_bytes(b"\x89PNG")
    findings, warnings = check(copy)
    assert warnings == ["frames"]
    assert findings["frames"].evidence["unreadable share"] == pytest.approx(6 / NUM_FRAMES)
    recording = open_recording(copy)
    for path in files:
        path.write_bytes(b"\x89PNG")
    with pytest.raises(InputError, match="No frame of copy can be read"):
        check_recording(recording)


@pytest.mark.parametrize(
    "source",
    ["data/7scenes/redkitchen", "data/tum/rgbd_dataset_freiburg1_rpy", "data/tartanair/hospital_clip"],
)
def test_real_recordings_are_good(sfgs_data, source):
    recording = open_recording(sfgs_data / source, options=ReaderOptions(start=40, end=64))
    assert check_recording(recording).warnings == ()
