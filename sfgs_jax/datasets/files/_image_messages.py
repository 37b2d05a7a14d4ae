"""Images in messages of ROS: sensor_msgs/Image and sensor_msgs/CompressedImage."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, Shaped

from sfgs_jax.arrays import FrameError, excerpt
from sfgs_jax.datasets.files._bag import Bag
from sfgs_jax.datasets.files._images import (
    colour_of_bgr,
    colour_of_bytes,
    depth_of_array,
    depth_of_bytes,
)

# Number type and channels of an encoding, and how OpenCV turns it into BGR.
_COLOUR = {
    "bgr8": (np.uint8, 3, None),
    "8UC3": (np.uint8, 3, None),
    "rgb8": (np.uint8, 3, cv2.COLOR_RGB2BGR),
    "bgra8": (np.uint8, 4, cv2.COLOR_BGRA2BGR),
    "rgba8": (np.uint8, 4, cv2.COLOR_RGBA2BGR),
    "mono8": (np.uint8, 1, cv2.COLOR_GRAY2BGR),
    "8UC1": (np.uint8, 1, cv2.COLOR_GRAY2BGR),
}
_DEPTH = {"16UC1": np.uint16, "mono16": np.uint16, "32FC1": np.float32}
# Before the PNG of compressedDepth: its format, and the quantisation of floats, which 16 bits do without.
_COMPRESSED_DEPTH_HEADER = 12


@dataclass(frozen=True)
class ImageMessage:
    """An image in a bag, a `ColourImage` and a `DepthImage`.

    Attributes:
        bag: the bag.
        topic: the image's topic.
        time: when its message was recorded, nanoseconds.
    """

    bag: Bag
    topic: str
    time: int

    def rgb(self) -> Float[np.ndarray, "h w 3"]:
        """RGB in [0, 1]. Raises FrameError if the message is no colour image."""
        message = self._message()
        if not hasattr(message, "encoding"):
            return colour_of_bytes(bytes(message.data), str(self))
        if message.encoding not in _COLOUR:
            raise FrameError(f"{self} is encoded as {message.encoding}, which is no colour that can be read.")
        kind, channels, conversion = _COLOUR[message.encoding]
        image = self._pixels(message, kind, channels)
        return colour_of_bgr(image if conversion is None else np.asarray(cv2.cvtColor(image, conversion)))

    def metres(self, units_per_metre: float | None) -> Float[np.ndarray, "h w"]:
        """Depth in metres, 0 where missing. Raises FrameError if the message is no depth image."""
        message = self._message()
        if not hasattr(message, "encoding"):
            return self._compressed_metres(message, units_per_metre)
        if message.encoding not in _DEPTH:
            raise FrameError(f"{self} is encoded as {message.encoding}, which is no depth that can be read.")
        image = self._pixels(message, _DEPTH[message.encoding], 1)[..., 0]
        return depth_of_array(image, units_per_metre, str(self))

    def __str__(self) -> str:
        return f"the message of {self.topic} at {self.time} ns in {self.bag.path}"

    def _message(self) -> Any:
        message = self.bag.message(self.topic, self.time)
        raw = all(hasattr(message, name) for name in ("encoding", "height", "width", "step", "is_bigendian"))
        if not hasattr(message, "data") or not (raw or hasattr(message, "format")):
            raise FrameError(f"{self} is no image as ROS defines it.")
        return message

    def _compressed_metres(self, message: Any, units_per_metre: float | None) -> Float[np.ndarray, "h w"]:
        data, kind = bytes(message.data), str(message.format)
        if "compressedDepth" in kind:
            if not kind.startswith("16UC1"):
                raise FrameError(f"{self} has the format {excerpt(kind)}; only 16UC1 can be read compressed.")
            data = data[_COMPRESSED_DEPTH_HEADER:]
        return depth_of_bytes(data, units_per_metre, str(self))

    def _pixels(self, message: Any, kind: type[np.generic], channels: int) -> Shaped[np.ndarray, "h w c"]:
        """(height, width, channels) of a raw image, without the padding of its rows."""
        order = ">" if message.is_bigendian else "<"
        dtype = np.dtype(kind).newbyteorder(order)
        height, width, step = int(message.height), int(message.width), int(message.step)
        row = width * channels * dtype.itemsize
        data = np.asarray(message.data, np.uint8).reshape(-1)
        if min(height, width) < 1 or step < row or len(data) < height * step:
            raise FrameError(f"{self} is damaged: {len(data)} bytes for {width}x{height} pixels.")
        rows = np.ascontiguousarray(data[: height * step].reshape(height, step)[:, :row])
        return rows.view(dtype).astype(kind, copy=False).reshape(height, width, channels)
