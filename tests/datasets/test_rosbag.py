"""Bags of ROS 1 and 2 and MCAP: topics, encodings, and depth from a camera of its own."""

import sys

import cv2
import numpy as np
import pytest
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_typestore

from sfgs_jax.arrays import FrameError, InputError
from sfgs_jax.datasets import SyntheticRecording, open_recording, prefetch
from sfgs_jax.geometry import quaternions_from_rotations

COLOUR, DEPTH = "/camera/color/image_raw", "/camera/aligned_depth_to_color/image_raw"
INFO = "/camera/color/camera_info"
# The bag has later times than its headers.
LATENCY = 30_000_000


class Messages:
    """Makes messages of ROS 1 or 2, each with its topic and the time of its header in nanoseconds."""

    def __init__(self, ros: int) -> None:
        self.ros = ros
        self.store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)

    def make(self, kind: str, **fields):
        return self.store.types[kind](**fields)

    def header(self, time: int, frame: str):
        stamp = self.make("builtin_interfaces/msg/Time", sec=time // 10**9, nanosec=time % 10**9)
        sequence = {"seq": 0} if self.ros == 1 else {}
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **sequence)

    def image(self, time: int, image: np.ndarray, encoding: str, frame: str = "optical", padding: int = 0):
        rows = np.ascontiguousarray(image).view(np.uint8).reshape(len(image), -1)
        data = np.pad(rows, ((0, 0), (0, padding)), constant_values=99)
        return self.make(
            "sensor_msgs/msg/Image",
            header=self.header(time, frame),
            height=image.shape[0],
            width=image.shape[1],
            encoding=encoding,
            is_bigendian=0,
            step=data.shape[1],
            data=data.ravel(),
        )

    def compressed(self, time: int, data: bytes, kind: str, frame: str = "optical"):
        return self.make(
            "sensor_msgs/msg/CompressedImage",
            header=self.header(time, frame),
            format=kind,
            data=np.frombuffer(data, np.uint8),
        )

    def info(self, camera, frame: str = "optical", model: str = "plumb_bob", lens: tuple = (0.0,) * 5):
        K = np.asarray(camera.matrix(), float)
        P = np.hstack([K, np.zeros((3, 1))])
        values = {"D": np.array(lens), "K": K.ravel(), "R": np.eye(3).ravel(), "P": P.ravel()}
        region = self.make(
            "sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        )
        return self.make(
            "sensor_msgs/msg/CameraInfo",
            header=self.header(0, frame),
            height=camera.height,
            width=camera.width,
            distortion_model=model,
            binning_x=0,
            binning_y=0,
            roi=region,
            **(values if self.ros == 1 else {key.lower(): value for key, value in values.items()}),
        )

    def transforms(self, parent: str, child: str, T_parent_child: np.ndarray):
        w, x, y, z = quaternions_from_rotations(T_parent_child[None, :3, :3])[0]
        tx, ty, tz = T_parent_child[:3, 3]
        transform = self.make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(0, parent),
            child_frame_id=child,
            transform=self.make(
                "geometry_msgs/msg/Transform",
                translation=self.make("geometry_msgs/msg/Vector3", x=tx, y=ty, z=tz),
                rotation=self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
            ),
        )
        return self.make("tf2_msgs/msg/TFMessage", transforms=[transform])


def _write(path, messages: Messages, stream: list) -> None:
    """A bag of (topic, nanoseconds, message)."""
    if messages.ros == 1:
        writer = rosbag1.Writer(path)
        serialize = messages.store.serialize_ros1
    else:
        plugin = StoragePlugin.MCAP if "mcap" in path.name else StoragePlugin.SQLITE3
        writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
        serialize = messages.store.serialize_cdr
    with writer:
        connections = {}
        for topic, time, message in stream:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=messages.store)
            writer.write(connections[topic], time, serialize(message, kind))


def _time(n: int) -> int:
    return 1_700_000_000_000_000_000 + n * 33_000_000


def _stream(messages: Messages, room, capture) -> list:
    """Colour, depth 5 ms later, and camera information."""
    stream = [(INFO, _time(0), messages.info(room.camera))]
    for n, frame in enumerate(capture):
        units = np.round(frame.depth * 1000).astype(np.uint16)
        colour = messages.image(_time(n), frame.rgb, "rgb8", padding=7)
        depth = messages.image(_time(n) + 5_000_000, units, "16UC1", padding=2)
        stream += [(COLOUR, _time(n) + LATENCY, colour), (DEPTH, _time(n) + LATENCY + 1, depth)]
    return stream


@pytest.fixture
def messages():
    return Messages(2)


@pytest.fixture
def bag(tmp_path, messages):
    """Writes and opens the ROS 2 bag tmp_path/mcap of a stream of messages."""

    def make(stream: list):
        _write(tmp_path / "mcap", messages, stream)
        return open_recording(tmp_path / "mcap")

    return make


def _check(recording, room, capture) -> None:
    assert (recording.dataset, len(recording), recording.ground_truth) == ("rosbag", len(capture), None)
    assert recording.camera.shape == room.camera.shape
    np.testing.assert_allclose(recording.camera.matrix(), room.camera.matrix(), rtol=1e-6)
    expected = [_time(n) / 1e9 for n in range(len(capture))]
    np.testing.assert_allclose(recording.timestamps, expected, rtol=0, atol=1e-6)
    for i, frame in prefetch(recording):
        assert not isinstance(frame, FrameError)
        assert np.abs(frame.rgb - capture[i].rgb / 255).max() < 1e-6
        assert np.median(np.abs(frame.depth - room[i].depth)) < 0.001


@pytest.mark.parametrize("name", ["one.bag", "mcap", "database", "alone.mcap", "alone.db3"])
def test_images_times_and_intrinsics(tmp_path, room, capture, name):
    messages = Messages(1 if name == "one.bag" else 2)
    path = tmp_path / name
    if name.startswith("alone"):
        folder = tmp_path / ("mcap" if name.endswith("mcap") else "database")
        _write(folder, messages, _stream(messages, room, capture))
        next(folder.glob(f"*{path.suffix}")).rename(path)
    else:
        _write(path, messages, _stream(messages, room, capture))
    recording = open_recording(path)
    _check(recording, room, capture)
    assert recording.name == path.stem
    assert recording.notes == ()
    assert recording[3].depth_timestamp == pytest.approx(recording[3].timestamp + 0.005, abs=1e-6)


def test_compressed_images(bag, messages, room, capture):
    stream = [("/rgb/camera_info", _time(0), messages.info(room.camera))]
    for n, frame in enumerate(capture):
        bgr = cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2BGR)
        units = np.round(frame.depth * 1000).astype(np.uint16)
        png, depth = (cv2.imencode(".png", image)[1].tobytes() for image in (bgr, units))
        header = bytes(12)
        stream += [
            ("/rgb/image/compressed", _time(n), messages.compressed(_time(n), png, "rgb8; png")),
            (
                "/depth/image/compressedDepth",
                _time(n),
                messages.compressed(_time(n), header + depth, "16UC1; compressedDepth"),
            ),
        ]
    _check(bag(stream), room, capture)


@pytest.mark.parametrize(
    ("encoding", "change"),
    [
        ("bgr8", lambda rgb: rgb[..., ::-1]),
        ("bgra8", lambda rgb: np.dstack([rgb[..., ::-1], rgb[..., 0]])),
        ("rgba8", lambda rgb: np.dstack([rgb, rgb[..., 0]])),
    ],
)
def test_encodings_and_depth_in_metres(bag, messages, room, capture, encoding, change):
    stream = [(INFO, _time(0), messages.info(room.camera))]
    for n, frame in enumerate(capture):
        depth = frame.depth.copy()
        depth[:2] = np.nan
        stream += [
            (COLOUR, _time(n), messages.image(_time(n), change(frame.rgb), encoding)),
            (DEPTH, _time(n), messages.image(_time(n), depth, "32FC1")),
        ]
    recording = bag(stream)
    _check(recording, room, capture)
    assert (recording[0].depth[:4] == 0).all()


def test_depth_of_another_camera_is_drawn_into_colours_view(bag, messages, capture):
    room = SyntheticRecording(num_frames=5, width=40, height=30)
    T_link_colour = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    T_colour_depth = np.eye(4)
    T_colour_depth[0, 3] = 0.5
    wall = np.full((30, 40), 2.0, np.float32)
    wall[:, 20:] = 4.0
    stream = [
        ("/tf_static", _time(0), messages.transforms("link", "colour", T_link_colour)),
        ("/tf_static", _time(0) + 1, messages.transforms("link", "depth", T_link_colour @ T_colour_depth)),
        ("/color/camera_info", _time(0), messages.info(room.camera, "colour")),
        ("/depth/camera_info", _time(0), messages.info(room.camera, "depth")),
        (
            "/color/image",
            _time(0),
            messages.image(_time(0), np.full((30, 40, 3), 9, np.uint8), "rgb8", "colour"),
        ),
        ("/depth/image", _time(0), messages.image(_time(0), wall, "32FC1", "depth")),
    ]
    depth = bag(stream)[0].depth
    focal = 0.82 * 40
    # A point at z moves by focal * 0.5 m / z: the near half by 8 pixels, the far half by 4, hidden by it.
    shift = [round(focal * 0.5 / z) for z in (2.0, 4.0)]
    row = depth[15]
    assert (row[: shift[0] - 1] == 0).all()
    np.testing.assert_allclose(row[shift[0] + 1 : 20 + shift[0] - 1], 2.0)
    np.testing.assert_allclose(row[20 + shift[0] + 1 :], 4.0)


def test_depth_of_an_unknown_frame_is_refused(bag, messages, room, capture):
    stream = [
        (INFO, _time(0), messages.info(room.camera)),
        ("/depth/camera_info", _time(0), messages.info(room.camera, "elsewhere")),
        (COLOUR, _time(0), messages.image(_time(0), capture[0].rgb, "rgb8")),
        ("/depth/image", _time(0), messages.image(_time(0), capture[0].depth, "32FC1", "elsewhere")),
    ]
    with pytest.raises(InputError, match="'elsewhere', colour in 'optical', and no static transforms"):
        bag(stream)


def test_topics_are_chosen_by_name(bag, tmp_path, messages, room, capture):
    stream = _stream(messages, room, capture)
    for n in range(5):
        dark = messages.image(_time(n), np.zeros((60, 80, 3), np.uint8), "rgb8")
        stream += [("/camera/infra1/image", _time(n), dark), ("/another/image", _time(n), dark)]
    recording = bag(stream)
    expected = f"{tmp_path / 'mcap'} has several topics of colour images; {COLOUR} is used."
    assert recording.notes == (expected,)
    assert np.abs(recording[2].rgb - capture[2].rgb / 255).max() < 1e-6


def test_images_without_depth_are_left_out(bag, messages, room, capture):
    stream = [row for row in _stream(messages, room, capture) if row[0] != DEPTH or row[1] < _time(3)]
    recording = bag(stream)
    assert recording.notes == (f"2 of 5 images of {COLOUR} have no depth in time.",)


def test_a_message_that_is_no_image_is_a_frame_error(bag, messages, room, capture):
    stream = _stream(messages, room, capture)
    broken = messages.image(_time(1), capture[1].rgb, "rgb8")
    broken.height = 1_000_000
    odd = messages.image(_time(2), capture[2].rgb, "yuv422")
    grey = messages.image(_time(3), capture[3].rgb[..., 0], "mono8")
    for n, message in ((1, broken), (2, odd), (3, grey)):
        stream[1 + 2 * n] = (COLOUR, stream[1 + 2 * n][1], message)
    recording = bag(stream)
    for n, words in ((1, "is damaged"), (2, "encoded as yuv422")):
        with pytest.raises(FrameError, match=words):
            recording[n]
    np.testing.assert_allclose(recording[3].rgb[..., 1], capture[3].rgb[..., 0] / 255, atol=1e-6)


@pytest.mark.parametrize(
    ("without", "message"),
    [
        (COLOUR, "has no topic of colour images"),
        (DEPTH, f"has no topic of depth images; its topics are {INFO}, {COLOUR}"),
        (INFO, f"has no CameraInfo of {COLOUR}"),
    ],
)
def test_what_is_missing_is_named(bag, messages, room, capture, without, message):
    with pytest.raises(InputError, match=message):
        bag([row for row in _stream(messages, room, capture) if row[0] != without])


def test_lenses(bag, messages, room, capture):
    stream = _stream(messages, room, capture)
    stream[0] = (INFO, _time(0), messages.info(room.camera, lens=(0.2, 0.0, 0.0, 0.0, 0.0)))
    recording = bag(stream)
    assert recording[0].depth[0, 0] == 0
    assert recording[0].depth[30, 40] > 0


def test_a_lens_that_cannot_be_taken_out(bag, messages, room, capture):
    stream = _stream(messages, room, capture)
    stream[0] = (INFO, _time(0), messages.info(room.camera, model="equidistant", lens=(0.2, 0.0, 0.0, 0.0)))
    with pytest.raises(InputError, match="lens model 'equidistant'"):
        bag(stream)


def test_recordings_of_the_realsense_sdk_are_refused(bag, messages, room, capture):
    stream = _stream(messages, room, capture)
    topic = "/device_0/sensor_0/Depth_0/image/data"
    with pytest.raises(InputError, match="recorded by the RealSense SDK"):
        bag([*stream, (topic, _time(0), messages.image(_time(0), capture[0].depth, "32FC1"))])


@pytest.mark.parametrize("name", ["one.bag", "two.mcap", "three.db3"])
@pytest.mark.parametrize("data", [b"", b"no bag at all"])
def test_damaged_bags(tmp_path, name, data):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError, match="cannot be read as a bag") as caught:
        open_recording(tmp_path / name)
    assert len(str(caught.value).splitlines()) == 1


def test_without_the_package_one_sentence_says_how_to_get_it(tmp_path, monkeypatch):
    (tmp_path / "one.bag").write_bytes(b"")
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(InputError, match=r"pip install 'sfgs-jax\[rosbag\]'"):
        open_recording(tmp_path / "one.bag")


def test_damage_to_a_topics_name_is_not_quoted_at_length(bag, messages, room, capture):
    stream = _stream(messages, room, capture[:1])
    damaged = [(topic.replace("color/image", f"color/{'x' * 300}"), *rest) for topic, *rest in stream]
    with pytest.raises(InputError, match="has no topic of colour images") as caught:
        bag(damaged)
    assert len(str(caught.value)) < 400
