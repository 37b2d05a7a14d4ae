"""XFeat in onnxruntime: the teacher of the keypoint labels, and a peer to be measured against.

Source: Potje et al., XFeat: Accelerated Features for Lightweight Image Matching, CVPR 2024.
"""

import os
from pathlib import Path

import cv2
import numpy as np
import onnxruntime
from jaxtyping import Float

from sfgs_jax.arrays import InputError
from sfgs_jax.superfeats import Features, pack_features

MIN_SIMILARITY = 0.82
"""Cosine below which XFeat's own matching drops a mutual nearest neighbour."""

_CELL = 8
_MIN_HEAT = 0.05
_SUPPRESSION = np.ones((5, 5), np.uint8)
_CUBIC = -0.75


def default_weights() -> Path:
    """Path of the network in the data folder.

    Raises:
        InputError: there is no such file.
    """
    root = Path(os.environ.get("SFGS_DATA", Path(__file__).parents[2] / "shared"))
    path = root / "weights" / "xfeat_640x640.onnx"
    if not path.is_file():
        raise InputError(f"There is no {path}; set SFGS_DATA to the folder that holds weights/.")
    return path


def normalised(grey: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """The image with mean 0 and variance 1, the network's input."""
    return np.asarray((grey - grey.mean()) / np.sqrt(grey.var() + 1e-5), np.float32)


class XFeat:
    """The network at the one input size of its file, and the extraction around it.

    Attributes:
        shape: height and width of the network's input.
    """

    def __init__(self, model: Path | bytes | None = None, *, threads: int = 2) -> None:
        """Load a model file, or its bytes; None means `default_weights()`."""
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        source = default_weights() if model is None else model
        self._session = onnxruntime.InferenceSession(
            source if isinstance(source, bytes) else str(source), options, ["CPUExecutionProvider"]
        )
        given = self._session.get_inputs()[0]
        self._input = given.name
        self.shape: tuple[int, int] = (given.shape[2], given.shape[3])

    def dense(
        self, image: Float[np.ndarray, "h w"]
    ) -> tuple[
        Float[np.ndarray, "h/8 w/8 65"], Float[np.ndarray, "h/8 w/8 64"], Float[np.ndarray, "h/8 w/8"]
    ]:
        """Keypoint logits, descriptors (not of unit length) and reliability of each 8x8 cell.

        Logit 8 r + c belongs to the pixel in row r and column c of its cell, the last one to the dustbin.

        Args:
            image: of the network's input size, `normalised`.
        """
        descriptors, logits, reliability = self._session.run(
            ["output_feats", "output_keypoints", "output_heatmap"], {self._input: image[None, None]}
        )
        return np.asarray(logits)[0], np.asarray(descriptors)[0], np.asarray(reliability)[0, 0]

    def extract(
        self, image: Float[np.ndarray, "h w"] | Float[np.ndarray, "h w 3"], *, max_keypoints: int = 2048
    ) -> Features:
        """XFeat's keypoints of an image.

        The network's input has one size. A larger image is shrunk to fit. The rest of the input, below and on
        the right, is filled with the image's mean. Keypoints are in pixels of the given image.

        Args:
            image: grey (H, W) or RGB (H, W, 3), of any size.
            max_keypoints: slots of the result.
        """
        grey = image.mean(axis=2) if image.ndim == 3 else image
        given = grey.shape
        scale = min(1.0, self.shape[0] / given[0], self.shape[1] / given[1])
        height, width = (min(round(n * scale), m) for n, m in zip(given, self.shape, strict=True))
        if scale < 1:
            grey = cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA)
        padded = np.zeros(self.shape, np.float32)
        padded[:height, :width] = normalised(grey)
        rows, columns = -(-height // _CELL), -(-width // _CELL)
        logits, descriptors, reliability = (dense[:rows, :columns] for dense in self.dense(padded))

        heat = _heat(logits)[:height, :width]
        v, u = np.nonzero((heat == cv2.dilate(heat, _SUPPRESSION)) & (heat > _MIN_HEAT))
        pixels = np.stack([u, v], axis=1)
        # XFeat stretches pixels 0 to n - 1 over the whole map, from edge to edge.
        size = np.asarray(self.shape[::-1])
        cells = pixels * (size / _CELL / (size - 1)) - 0.5
        scores = heat[v, u] * _sample(reliability[..., None], cells, _linear)[:, 0]
        best = np.argsort(-scores, kind="stable")[:max_keypoints]
        sampled = _sample(_unit(descriptors), cells[best], _cubic)
        stretch = np.asarray(given[::-1]) / (width, height)
        keypoints = (pixels[best] + 0.5) * stretch - 0.5
        return pack_features(keypoints, scores[best], _unit(sampled), capacity=max_keypoints)


def _heat(logits: Float[np.ndarray, "r c 65"]) -> Float[np.ndarray, "h w"]:
    """Probability of a keypoint at each pixel."""
    rows, columns = logits.shape[:2]
    weights = np.exp(logits - logits.max(axis=-1, keepdims=True))
    probabilities = weights[..., :-1] / weights.sum(axis=-1, keepdims=True)
    cells = probabilities.reshape(rows, columns, _CELL, _CELL)
    return np.ascontiguousarray(cells.swapaxes(1, 2).reshape(rows * _CELL, columns * _CELL))


def _unit(vectors: Float[np.ndarray, "*n d"]) -> Float[np.ndarray, "*n d"]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def _linear(fraction: np.ndarray) -> tuple[np.ndarray, ...]:
    """Weights of the neighbours at 0 and 1."""
    return 1 - fraction, fraction


def _cubic(fraction: np.ndarray) -> tuple[np.ndarray, ...]:
    """Weights of the neighbours at -1, 0, 1 and 2 (Keys' cubic convolution)."""

    def near(t: np.ndarray) -> np.ndarray:
        return ((_CUBIC + 2) * t - (_CUBIC + 3)) * t * t + 1

    def far(t: np.ndarray) -> np.ndarray:
        return ((_CUBIC * t - 5 * _CUBIC) * t + 8 * _CUBIC) * t - 4 * _CUBIC

    return far(1 + fraction), near(fraction), near(1 - fraction), far(2 - fraction)


def _sample(dense: Float[np.ndarray, "r c d"], points: Float[np.ndarray, "n 2"], kernel) -> np.ndarray:
    """(n, d) values at positions (column, row) between the cells; beyond the map there are zeros."""
    base = np.floor(points).astype(int)
    fractions = (points - base).astype(np.float32)
    weights_u, weights_v = kernel(fractions[:, 0]), kernel(fractions[:, 1])
    margin = len(weights_u) // 2
    padded = np.pad(dense, ((margin, margin), (margin, margin), (0, 0)))
    stride = padded.shape[1]
    flat = padded.reshape(-1, dense.shape[2])
    corner = (base[:, 1] + 1) * stride + base[:, 0] + 1
    total = np.zeros((len(points), dense.shape[2]), np.float32)
    for row, weight_v in enumerate(weights_v):
        for column, weight_u in enumerate(weights_u):
            total += (weight_u * weight_v)[:, None] * flat[corner + row * stride + column]
    return total
