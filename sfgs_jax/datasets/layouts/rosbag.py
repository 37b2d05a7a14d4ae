"""Bags of ROS 1 (.bag) and ROS 2 (folder, .mcap, .db3) with colour, depth and camera information.

Topics are chosen by type and name. Depth of the colour camera's frame is registered already. Other depth is
drawn into the colour camera's view by the static transforms of the bag. Time stamps are the headers'.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError, excerpt
from sfgs_jax.datasets._association import associate
from sfgs_jax.datasets._options import ReaderOptions
from sfgs_jax.datasets.files import (
    Bag,
    CommonView,
    DepthRegistration,
    FilePair,
    FileRecording,
    ImageMessage,
    Intrinsics,
    common_view,
    depth_notes,
    first_readable,
    inverse_poses,
    quaternion_poses,
    read_camera_json,
    scaled_intrinsics,
    working_size,
)

_FILES = (".bag", ".mcap", ".db3")
_RAW, _COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
_CAMERA_INFO, _TRANSFORMS = "sensor_msgs/msg/CameraInfo", "tf2_msgs/msg/TFMessage"
_LENS_MODELS = ("", "plumb_bob", "rational_polynomial")
_REGISTERED = ("aligned", "registered")
_LENS_COUNTS = (0, 4, 5, 8)
_MOST_TOPICS = 20
"""Topics that a message lists."""


def matches(source: Path) -> bool:
    """True for a .bag, .mcap or .db3 file, and for the folder of a ROS 2 bag."""
    if source.is_file():
        return source.suffix.lower() in _FILES
    return (source / "metadata.yaml").is_file() and any(
        path.suffix in (".mcap", ".db3", ".zstd") for path in source.iterdir()
    )


def read(source: Path, options: ReaderOptions) -> FileRecording:
    """Open a bag. Arguments and errors as of `open_recording`."""
    try:
        return _read(Bag(source), source, options)
    except AttributeError as error:
        raise InputError(
            f"The messages of {source} are not as ROS defines them: {excerpt(error)}."
        ) from error


def _read(bag: Bag, source: Path, options: ReaderOptions) -> FileRecording:
    colour_topic, depth_topic, notes = _topics(bag)
    colour, depth = _Stream.read(bag, colour_topic), _Stream.read(bag, depth_topic)
    matched = associate(colour.times, depth.times, options.association_limit)
    pairs = [
        FilePair(
            ImageMessage(bag, colour_topic, colour.recorded[i]),
            ImageMessage(bag, depth_topic, depth.recorded[j]),
            colour.times[i].item(),
            depth.times[j].item(),
        )
        for i, j in matched.tolist()
    ]
    left_out = len(colour.times) - len(pairs)
    if left_out:
        notes.append(f"{left_out} of {len(colour.times)} images of {colour_topic} have no depth in time.")
    cameras = _camera_infos(bag)
    if options.camera is not None:
        intrinsics = read_camera_json(options.camera)
    else:
        intrinsics = _intrinsics(bag, colour_topic, _info_of(colour_topic, colour.frame, cameras))
    if colour.frame == depth.frame or any(word in depth_topic for word in _REGISTERED):
        view = common_view(source, pairs, options.depth_scale, intrinsics)
    else:
        depth_info = _info_of(depth_topic, depth.frame, cameras)
        depth_intrinsics = _intrinsics(bag, depth_topic, depth_info)
        T_colour_depth = _extrinsics(bag, colour.frame, depth.frame)
        view = _registering_view(
            source, pairs, options.depth_scale, intrinsics, depth_intrinsics, T_colour_depth
        )
    return FileRecording(
        name=source.resolve().stem,
        dataset="rosbag",
        camera=view.camera,
        pairs=pairs,
        units_per_metre=options.depth_scale,
        ground_truth=None,
        notes=(*intrinsics.notes, *notes, *view.notes),
        register=view.register,
    )


def _topics(bag: Bag) -> tuple[str, str, list[str]]:
    """Topics of colour and depth, and notes where there are several."""
    if any(topic.startswith("/device_") for topic in bag.topics):
        raise InputError(
            f"{bag.path} was recorded by the RealSense SDK, which does not align depth to colour; save "
            "aligned frames as a plain folder (docs/datasets.md)."
        )
    images = [topic for topic, kind in bag.topics.items() if kind in (_RAW, _COMPRESSED)]
    depth = [topic for topic in images if "depth" in topic.lower()]
    colour = [topic for topic in images if topic not in depth and "infra" not in topic.lower()]
    chosen, notes = [], []
    for name, topics, words in (("colour", colour, ("color", "rgb")), ("depth", depth, _REGISTERED)):
        if not topics:
            found = ", ".join(sorted(bag.topics)[:_MOST_TOPICS]) or "none"
            raise InputError(f"{bag.path} has no topic of {name} images; its topics are {found}.")
        # Preferred words first, then images without loss.
        topics = sorted(
            topics, key=lambda topic: (not any(w in topic for w in words), bag.topics[topic] != _RAW, topic)
        )
        others = [topic for topic in topics[1:] if not topic.startswith(topics[0])]
        if others:
            notes.append(f"{bag.path} has several topics of {name} images; {topics[0]} is used.")
        chosen.append(topics[0])
    return chosen[0], chosen[1], notes


@dataclass(frozen=True)
class _Stream:
    """The images of a topic.

    Attributes:
        times: (N,) seconds by their headers, sorted.
        recorded: when each was recorded, nanoseconds.
        frame: name of the camera's coordinates.
    """

    times: Float[np.ndarray, " n"]
    recorded: list[int]
    frame: str

    @staticmethod
    def read(bag: Bag, topic: str) -> "_Stream":
        rows: dict[int, float] = {}
        frame = ""
        for recorded, message in bag.messages(topic):
            stamp = message.header.stamp
            time = stamp.sec + stamp.nanosec * 1e-9
            rows[recorded] = time or recorded * 1e-9
            frame = _name(message.header.frame_id)
        ordered = sorted(rows.items(), key=lambda row: row[1])
        return _Stream(
            np.asarray([time for _, time in ordered], np.float64), [row for row, _ in ordered], frame
        )


def _name(frame_id: str) -> str:
    """A frame's name; ROS 1 may begin it with a slash."""
    return frame_id.lstrip("/")


def _camera_infos(bag: Bag) -> dict[str, Any]:
    """The first message of each topic of camera information."""
    topics = (topic for topic, kind in bag.topics.items() if kind == _CAMERA_INFO)
    found = ((topic, next(bag.messages(topic), None)) for topic in topics)
    return {topic: first[1] for topic, first in found if first is not None}


def _info_of(topic: str, frame: str, cameras: dict[str, Any]) -> Any | None:
    """Camera information of an image topic: beside it or above it, else of the same frame; None without."""
    folder = topic
    while "/" in folder:
        folder = folder.rpartition("/")[0]
        if (name := f"{folder}/camera_info") in cameras:
            return cameras[name]
    return next((info for info in cameras.values() if _name(info.header.frame_id) == frame), None)


def _intrinsics(bag: Bag, topic: str, info: Any | None) -> Intrinsics:
    if info is None:
        raise InputError(f"{bag.path} has no CameraInfo of {topic}; give a camera.json (--reader.camera).")
    # ROS 1 has capital letters.
    K = np.asarray(getattr(info, "k", getattr(info, "K", ())), np.float64).ravel()
    lens = tuple(float(x) for x in getattr(info, "d", getattr(info, "D", ())))
    if "rect" in topic.rpartition("/")[2]:
        K = np.asarray(getattr(info, "p", getattr(info, "P", ())), np.float64).reshape(-1, 4)[:, :3].ravel()
        lens = ()
    if (
        len(K) != 9
        or (any(lens) and info.distortion_model not in _LENS_MODELS)
        or len(lens) not in _LENS_COUNTS
    ):
        raise InputError(
            f"The CameraInfo of {topic} in {bag.path} can't be used (lens model "
            f"{excerpt(info.distortion_model)}); undistort the images before, or give a camera.json "
            "(--reader.camera)."
        )
    return Intrinsics(
        float(K[0]),
        float(K[4]),
        float(K[2]),
        float(K[5]),
        width=int(info.width) or None,
        height=int(info.height) or None,
        distortion=lens if any(lens) else (),
    )


def _registering_view(
    source: Path,
    pairs: Sequence[FilePair],
    units_per_metre: float | None,
    intrinsics: Intrinsics,
    depth_intrinsics: Intrinsics,
    T_colour_depth: Float[np.ndarray, "4 4"],
) -> CommonView:
    """The colour camera at a size that depth can fill."""
    rgb, depth = first_readable(source, pairs, units_per_metre)
    colour_size, depth_size = (rgb.shape[1], rgb.shape[0]), (depth.shape[1], depth.shape[0])
    intrinsics.camera(*colour_size, source)  # is of colour's size, or says so
    size = working_size(colour_size, depth_size)
    scaled = scaled_intrinsics(intrinsics, colour_size, size)
    camera = scaled.camera(*size, source)
    registration = DepthRegistration(
        depth_intrinsics.pinhole(source).camera(*depth_size, source),
        camera,
        T_colour_depth,
        colour_size=colour_size,
        undistortion=scaled.undistortion(camera),
    )
    return CommonView(camera, registration, depth_notes(depth))


def _extrinsics(bag: Bag, colour: str, depth: str) -> Float[np.ndarray, "4 4"]:
    """`T_colour_depth` along the static transforms of the bag, by breadth-first search."""
    edges: dict[str, list[tuple[str, Float[np.ndarray, "4 4"]]]] = {}
    topics = [topic for topic, kind in bag.topics.items() if kind == _TRANSFORMS and "static" in topic]
    for topic in topics:
        for _, message in bag.messages(topic):
            for transform in message.transforms:
                parent, child = _name(transform.header.frame_id), _name(transform.child_frame_id)
                T_parent_child = _matrix(transform.transform)
                edges.setdefault(parent, []).append((child, T_parent_child))
                edges.setdefault(child, []).append((parent, inverse_poses(T_parent_child[None])[0]))
    reached = {colour: np.eye(4)}
    waiting = deque([colour])
    while waiting:
        frame = waiting.popleft()
        for other, T_frame_other in edges.get(frame, []):
            if other not in reached:
                reached[other] = reached[frame] @ T_frame_other
                waiting.append(other)
    if depth not in reached or not np.isfinite(reached[depth]).all():
        raise InputError(
            f"Depth of {bag.path} is in the frame {excerpt(depth)}, colour in {excerpt(colour)}, and "
            "no static transforms join them; record depth that is aligned to colour, or /tf_static."
        )
    return reached[depth]


def _matrix(transform: Any) -> Float[np.ndarray, "4 4"]:
    t, q = transform.translation, transform.rotation
    return quaternion_poses(np.array([[t.x, t.y, t.z]]), np.array([[q.x, q.y, q.z, q.w]]))[0]
