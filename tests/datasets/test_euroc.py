"""EuRoC's layout with depth: lists in nanoseconds, poses of a body."""

import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import ReaderOptions, open_recording
from sfgs_jax.geometry import quaternions_from_rotations

START = 1403636579763555584
STEP = 50_000_000
# The camera looks along the body's y axis.
T_BODY_CAMERA = np.array([[1.0, 0, 0, 0.05], [0, 0, 1, -0.02], [0, -1, 0, 0.01], [0, 0, 0, 1]])


def _sensor(room, **changes: str) -> str:
    camera = room.camera
    entries = {
        "T_BS": "\n  cols: 4\n  rows: 4\n  data: [" + ",\n    ".join(map(str, T_BODY_CAMERA.ravel())) + "]",
        "rate_hz": "20",
        "resolution": f"[{room.width}, {room.height}]",
        "camera_model": "pinhole",
        "intrinsics": f"[{camera.fx}, {camera.fy}, {camera.cx}, {camera.cy}] #fu, fv, cu, cv",
        "distortion_model": "radial-tangential",
        "distortion_coefficients": "[0.0, 0.0, 0.0, 0.0]",
        **changes,
    }
    return "# Sensor\nsensor_type: camera\n" + "".join(f"{key}: {value}\n" for key, value in entries.items())


@pytest.fixture
def desk(tmp_path, room, capture, write_image):
    root = tmp_path / "desk/mav0"
    lists = {"cam0": "#timestamp [ns],filename\r\n", "depth0": "#timestamp [ns],filename\n"}
    truth = (
        "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []\n"
    )
    for n, frame in enumerate(capture):
        time = START + n * STEP
        write_image(root / f"cam0/data/{time}.png", frame.rgb)
        write_image(root / f"depth0/data/{n}.png", np.round(frame.depth * 1000).astype(np.uint16))
        lists["cam0"] += f"{time},{time}.png\r\n"
        lists["depth0"] += f"{time + 4_000_000},{n}.png\n"
        T_world_body = frame.pose @ np.linalg.inv(T_BODY_CAMERA)
        quaternion = quaternions_from_rotations(T_world_body[None, :3, :3])[0]
        numbers = (*T_world_body[:3, 3], *quaternion, 0.1, 0.2)
        truth += ",".join([str(time), *(f"{number:.12f}" for number in numbers)]) + "\n"
    for name, text in lists.items():
        (root / name / "data.csv").write_text(text)
    (root / "cam0/sensor.yaml").write_text(_sensor(room))
    (root / "state_groundtruth_estimate0").mkdir()
    (root / "state_groundtruth_estimate0/data.csv").write_text(truth)
    return tmp_path / "desk"


def test_images_poses_and_intrinsics(desk, check_capture):
    recording = open_recording(desk)
    check_capture(recording, dataset="euroc")
    assert recording.name == "desk"
    np.testing.assert_allclose(recording.timestamps, (START + STEP * np.arange(5)) / 1e9, rtol=0, atol=1e-6)
    assert recording[2].depth_timestamp == pytest.approx(recording[2].timestamp + 0.004, abs=1e-6)
    assert open_recording(desk / "mav0").name == "desk"


def test_images_without_depth_are_left_out(desk):
    path = desk / "mav0/depth0/data.csv"
    path.write_text("\n".join(path.read_text().splitlines()[:-1]))
    recording = open_recording(desk)
    assert len(recording) == len(recording.ground_truth.timestamps) == 4
    assert recording.notes == ("1 of 5 images have no depth and are left out.",)
    with pytest.raises(InputError, match="No pairs of colour and depth"):
        open_recording(desk, options=ReaderOptions(association_limit=0.001))


def test_without_ground_truth_and_extrinsics(desk, room, capture):
    (desk / "mav0/cam0/sensor.yaml").write_text(_sensor(room, T_BS="unknown"))
    bodies = open_recording(desk).ground_truth.poses
    np.testing.assert_allclose(bodies[1] @ T_BODY_CAMERA, capture[1].pose, atol=1e-6)
    (desk / "mav0/state_groundtruth_estimate0/data.csv").unlink()
    assert open_recording(desk).ground_truth is None


def test_the_lens_is_taken_out(desk, room):
    (desk / "mav0/cam0/sensor.yaml").write_text(_sensor(room, distortion_coefficients="[0.2, 0, 0, 0]"))
    recording = open_recording(desk)
    assert recording[0].depth[0, 0] == 0
    assert recording[0].depth[30, 40] > 0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"intrinsics": "[1, 2, 3]"}, "should hold intrinsics"),
        ({"intrinsics": "[a, 2, 3, 4]"}, "should hold intrinsics"),
        ({"resolution": ""}, "should hold intrinsics"),
        ({"resolution": "[inf, nan]"}, "should hold intrinsics"),
        ({"resolution": "[752, 480]"}, "are for 752x480 images"),
        ({"camera_model": "omni"}, "only pinhole cameras"),
        (
            {"distortion_model": "equidistant", "distortion_coefficients": "[0.1, 0, 0, 0]"},
            "only pinhole cameras",
        ),
        ({"T_BS": "\n  data: [1, 2, 3]"}, "T_BS should be the 16 numbers"),
        ({"T_BS": "\n  data: [" + "2, " * 16 + "]"}, "T_BS should be the 16 numbers"),
    ],
)
def test_sensor_files_that_cannot_be_used(desk, room, changes, message):
    (desk / "mav0/cam0/sensor.yaml").write_text(_sensor(room, **changes))
    with pytest.raises(InputError, match=message) as caught:
        open_recording(desk)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("cam0", "1,../../secret.png\n", r"names '\.\./\.\./secret\.png', which lies outside"),
        ("depth0", "1,/etc/depth.png\n", "lies outside"),
        ("cam0", "9" * 5000 + ",a.png\n", "line 1: expected 'nanoseconds,file'"),
        ("cam0", "1.5,a.png\n", "line 1: expected 'nanoseconds,file'"),
        ("depth0", "#head\n1\n", "line 2: expected 'nanoseconds,file'"),
        ("state_groundtruth_estimate0", "1,2,3\n", "a time stamp, a position and a quaternion"),
    ],
)
def test_lists_that_cannot_be_used(desk, name, text, message):
    (desk / "mav0" / name / "data.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        open_recording(desk)


def test_a_recording_without_depth(desk):
    (desk / "mav0/depth0").rename(desk / "mav0/other")
    with pytest.raises(InputError, match=r"has no depth0/data\.csv"):
        open_recording(desk)
