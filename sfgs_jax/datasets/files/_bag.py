"""Bags of ROS 1 and ROS 2, and MCAP files, by the optional package rosbags."""

import importlib
import threading
import weakref
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from sfgs_jax.arrays import FrameError, InputError, excerpt, require_file

_LONGEST_NAME = 255
"""Characters of a topic's name."""
_LARGEST = {".yaml": 1 << 24, **dict.fromkeys((".mcap", ".db3", ".zstd"), 1 << 62)}
"""Bytes of the files of a ROS 2 bag, by suffix."""


class Bag:
    """Messages of a bag by topic and time.

    Each thread reads by a reader of its own, since a database belongs to the thread that opened it.

    Attributes:
        path: a .bag, .mcap or .db3 file, or the folder of a ROS 2 bag.
        topics: type of the messages by topic, such as `sensor_msgs/msg/Image`. Names longer than ROS allows
            are left out.
    """

    def __init__(self, path: Path) -> None:
        """Open a bag.

        Raises:
            InputError: the package is missing, or the bag can't be read.
        """
        self.path = path
        self._local = threading.local()
        self._readers: list[Any] = []
        weakref.finalize(self, _close, self._readers)
        try:
            importlib.import_module("rosbags.highlevel")
        except ImportError as error:
            raise InputError(f"{path} is a bag of ROS; pip install 'sfgs-jax[rosbag]' to read it.") from error
        try:
            # The package waits for what a pipe may bring, and takes minutes for metadata of a gigabyte.
            for file in path.iterdir() if path.is_dir() else ():
                if file.suffix in _LARGEST:
                    require_file(file, _LARGEST[file.suffix])
            self.topics = {
                connection.topic: connection.msgtype
                for connection in self._reader().connections
                if len(connection.topic) <= _LONGEST_NAME
            }
        except Exception as error:  # the package raises errors of many kinds at damaged files
            raise InputError(f"{path} cannot be read as a bag: {excerpt(error)}.") from error

    def messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Messages of a topic with the times at which they were recorded, nanoseconds, in order of time.

        Raises:
            InputError: the bag is damaged.
        """
        try:
            reader = self._reader()
            wanted = [connection for connection in reader.connections if connection.topic == topic]
            for connection, time, data in reader.messages(connections=wanted) if wanted else ():
                yield time, reader.deserialize(data, connection.msgtype)
        except Exception as error:
            raise InputError(f"{topic} of {self.path} cannot be read: {excerpt(error)}.") from error

    def message(self, topic: str, time: int) -> Any:
        """The message of a topic that was recorded at a time in nanoseconds.

        Raises:
            FrameError: there is none, or it is damaged.
        """
        try:
            reader = self._reader()
            wanted = [connection for connection in reader.connections if connection.topic == topic]
            for connection, _, data in reader.messages(connections=wanted, start=time, stop=time + 1):
                return reader.deserialize(data, connection.msgtype)
        except Exception as error:
            raise FrameError(f"{topic} of {self.path} cannot be read: {excerpt(error)}.") from error
        raise FrameError(f"{topic} of {self.path} has no message at {time} ns.")

    def _reader(self) -> Any:
        if not hasattr(self._local, "reader"):
            highlevel = importlib.import_module("rosbags.highlevel")
            typesys = importlib.import_module("rosbags.typesys")
            # Bags of ROS 2 before Iron don't describe their messages; those used here have not changed since.
            types = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
            reader = highlevel.AnyReader([self.path], default_typestore=types)
            reader.open()
            self._readers.append(reader)
            self._local.reader = reader
        return self._local.reader


def _close(readers: list[Any]) -> None:
    for reader in readers:
        with suppress(Exception):
            reader.close()
