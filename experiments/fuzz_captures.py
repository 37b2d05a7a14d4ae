"""Written stand-ins of captures in videos, archives, compressed depth and bags of ROS."""

import io
import json
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_typestore

_WIDTH, _HEIGHT = 24, 16
_NUM_FRAMES = 2
_K = np.array([[20.0, 0, 11.5], [0, 20, 7.5], [0, 0, 1]])
LZFSE = SimpleNamespace(decompress=zlib.decompress, error=zlib.error)
"""Another compression in the place of LZFSE, whose package is optional."""


def captures() -> dict[str, dict[str, bytes]]:
    """Files of captures, by their paths and the name of the layout. A single file is a capture by itself."""
    random = np.random.default_rng(0)
    colour = random.integers(0, 256, (_HEIGHT, _WIDTH, 3), dtype=np.uint8)
    depth = random.integers(1500, 2500, (_HEIGHT, _WIDTH), dtype=np.uint16)
    video, png, d16 = _video(colour), _png(colour), _png(depth)
    small, sure = _png(depth[::2, ::2]), _png(np.full((_HEIGHT // 2, _WIDTH // 2), 2, np.uint8))
    camera = json.dumps({"fx": 20.0, "fy": 20.0, "cx": 11.5, "cy": 7.5, "depth_scale": 1000.0}).encode()
    numbers = range(_NUM_FRAMES)
    odometry = "timestamp, frame, x, y, z, qx, qy, qz, qw\n" + "".join(
        f"{7000 + n / 60:.6f}, {n:06d}, 0.5, 0.25, -1, 0, 0, 0, 1\n" for n in numbers
    )
    record3d = _record3d(png, depth)
    return {
        "stray": {
            "odometry.csv": odometry.encode(),
            "camera_matrix.csv": "".join(", ".join(map(str, row)) + "\n" for row in _K.tolist()).encode(),
            "rgb.mp4": video,
            **{f"depth/{n:06d}.png": small for n in numbers},
            **{f"confidence/{n:06d}.png": sure for n in numbers},
        },
        "video and depth": {
            "clip.mp4": video,
            "camera.json": camera,
            "poses.txt": b"1 0 0 0.5 0 1 0 0 0 0 1 0 0 0 0 1\n" * _NUM_FRAMES,
            **{f"depth/{n}.png": d16 for n in numbers},
        },
        "record3d": record3d,
        "record3d, archive": {"desk.r3d": _zipped(record3d)},
        "colmap, binary": {
            **_colmap(),
            **{f"images/{n}.png": png for n in numbers},
            **{f"depth/{n}.png": d16 for n in numbers},
        },
        "ROS 1": _written(lambda path: _write_ros1(path / "desk.bag", colour, depth)),
        "ROS 2, MCAP": _written(lambda path: _write_ros2(path / "bag", StoragePlugin.MCAP, colour, depth)),
        "ROS 2, SQLite": _written(
            lambda path: _write_ros2(path / "bag", StoragePlugin.SQLITE3, colour, depth)
        ),
    }


def _png(image: np.ndarray) -> bytes:
    _, content = cv2.imencode(".png", image)
    return content.tobytes()


def _written(write: Callable[[Path], None]) -> dict[str, bytes]:
    """Files that something writes into a folder."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write(folder)
        paths = [path for path in folder.rglob("*") if path.is_file()]
        return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def _video(colour: np.ndarray) -> bytes:
    def write(folder: Path) -> None:
        code = cv2.VideoWriter.fourcc(*"mp4v")
        writer = cv2.VideoWriter(str(folder / "a.mp4"), code, 30, (_WIDTH, _HEIGHT))
        for _ in range(_NUM_FRAMES):
            writer.write(colour)
        writer.release()

    return _written(write)["a.mp4"]


def _record3d(png: bytes, depth: np.ndarray) -> dict[str, bytes]:
    metadata = {
        "K": _K.T.ravel().tolist(),
        "w": _WIDTH,
        "h": _HEIGHT,
        "fps": 60,
        "poses": [[0, 0, 0, 1, 0.5, 0.25, -1]] * _NUM_FRAMES,
        "frameTimestamps": [20.0 + n / 50 for n in range(_NUM_FRAMES)],
    }
    files = {"metadata": json.dumps(metadata).encode()}
    for n in range(_NUM_FRAMES):
        files[f"rgbd/{n}.jpg"] = png
        files[f"rgbd/{n}.depth"] = zlib.compress((depth / 1000).astype(np.float32).tobytes())
        files[f"rgbd/{n}.conf"] = zlib.compress(np.full(depth.shape, 2, np.uint8).tobytes())
    return files


def _zipped(files: dict[str, bytes]) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name), data)
    return content.getvalue()


def _colmap() -> dict[str, bytes]:
    """A binary model: a pinhole camera, and images with two points each."""
    cameras = struct.pack("<QiiQQ4d", 1, 7, 1, _WIDTH, _HEIGHT, 20, 20, 12, 8)
    images = struct.pack("<Q", _NUM_FRAMES)
    for n in range(_NUM_FRAMES):
        images += struct.pack("<I7dI", n + 1, 1, 0, 0, 0, 0.5, 0, 1, 7) + f"{n}.png".encode() + b"\0"
        images += struct.pack("<Q", 2) + bytes(24 * 2)
    return {"sparse/0/cameras.bin": cameras, "sparse/0/images.bin": images}


class _Messages:
    """Messages of colour, depth and camera information, by topic and time in nanoseconds."""

    def __init__(self, ros: int) -> None:
        self._ros = ros
        self.store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)

    def stream(self, colour: np.ndarray, depth: np.ndarray) -> list[tuple[str, int, Any]]:
        """All of them, in their order."""
        found = [("/camera/color/camera_info", 1_000_000_000, self._info())]
        for n in range(_NUM_FRAMES):
            time = 1_000_000_000 + n * 33_000_000
            found.append(("/camera/color/image_raw", time, self._image(time, colour, "rgb8")))
            found.append(
                ("/camera/aligned_depth_to_color/image_raw", time, self._image(time, depth, "16UC1"))
            )
        return found

    def _make(self, kind: str, **fields: Any) -> Any:
        return self.store.types[kind](**fields)

    def _header(self, time: int) -> Any:
        stamp = self._make("builtin_interfaces/msg/Time", sec=time // 10**9, nanosec=time % 10**9)
        sequence = {"seq": 0} if self._ros == 1 else {}
        return self._make("std_msgs/msg/Header", stamp=stamp, frame_id="optical", **sequence)

    def _image(self, time: int, image: np.ndarray, encoding: str) -> Any:
        data = image.reshape(len(image), -1).view(np.uint8)
        return self._make(
            "sensor_msgs/msg/Image",
            header=self._header(time),
            height=image.shape[0],
            width=image.shape[1],
            encoding=encoding,
            is_bigendian=0,
            step=data.shape[1],
            data=data.ravel(),
        )

    def _info(self) -> Any:
        P = np.hstack([_K, np.zeros((3, 1))])
        values = {"D": np.zeros(5), "K": _K.ravel(), "R": np.eye(3).ravel(), "P": P.ravel()}
        region = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
        return self._make(
            "sensor_msgs/msg/CameraInfo",
            header=self._header(0),
            height=_HEIGHT,
            width=_WIDTH,
            distortion_model="plumb_bob",
            binning_x=0,
            binning_y=0,
            roi=self._make("sensor_msgs/msg/RegionOfInterest", **region),
            **(values if self._ros == 1 else {key.lower(): value for key, value in values.items()}),
        )


def _write_ros1(path: Path, colour: np.ndarray, depth: np.ndarray) -> None:
    messages = _Messages(1)
    with rosbag1.Writer(path) as writer:
        _fill(writer, messages, messages.store.serialize_ros1, messages.stream(colour, depth))


def _write_ros2(path: Path, plugin: StoragePlugin, colour: np.ndarray, depth: np.ndarray) -> None:
    messages = _Messages(2)
    with rosbag2.Writer(path, version=9, storage_plugin=plugin) as writer:
        _fill(writer, messages, messages.store.serialize_cdr, messages.stream(colour, depth))


def _fill(writer: Any, messages: _Messages, serialize: Callable, stream: list[tuple[str, int, Any]]) -> None:
    connections: dict[str, Any] = {}
    for topic, time, message in stream:
        kind = message.__msgtype__
        if topic not in connections:
            connections[topic] = writer.add_connection(topic, kind, typestore=messages.store)
        writer.write(connections[topic], time, serialize(message, kind))
