"""Attributes of an SPZ file as streams of bytes, quantised, in the file's axes.

Source: github.com/nianticlabs/spz, the format's description and the numbers of its reference reader.
"""

import math
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, UInt8
from scipy.special import expit

from sfgs_jax.arrays import InputError
from sfgs_jax.splatting.files._loaded import logits_of_bytes

COEFFICIENTS = (1, 4, 9, 16)
"""Coefficients a channel of harmonics of degree 0 to 3, degree 0 included."""

_MOST_FRACTIONAL_BITS = 12
"""Positions are multiples of 2⁻¹² m, 0.24 mm, in maps that reach no farther than 2 km."""
_COLOUR_STEPS = 0.15 * 255
"""Steps of a byte for one unit of a coefficient of degree 0; 127.5 is the coefficient 0."""
_ROTATION_STEPS = 511 * math.sqrt(2)
"""Steps of nine bits for one unit of a quaternion's smaller components, which are at most √½."""
_OTHERS = np.asarray([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
"""Components beside the largest one, by its index."""


def stream_sizes(count: int, coefficients: int) -> tuple[int, ...]:
    """Bytes of positions, opacities, colours, scales, rotations and higher harmonics."""
    return 9 * count, count, 3 * count, 3 * count, 4 * count, 3 * (coefficients - 1) * count


def fractional_bits(means: Float[np.ndarray, "n 3"]) -> int:
    """Bits after the point, the most with which all positions fit into 24 bits.

    Raises:
        InputError: a position is 4000 km or farther from the origin.
    """
    farthest = float(np.max(np.abs(means), initial=0))
    bits = next((b for b in range(_MOST_FRACTIONAL_BITS, 0, -1) if farthest * 2**b < 2**23 - 1), None)
    if bits is None:
        raise InputError(f"A Gaussian is {farthest:.3g} m from the origin; SPZ holds less than 4000 km.")
    return bits


def streams_of(values: Mapping[str, np.ndarray], bits: int) -> list[bytes]:
    """The streams of Gaussians whose quaternions have unit length; `bits` as of `fractional_bits`."""
    fixed = np.round(values["means"].astype(np.float64) * 2**bits).astype("<i4")
    low_bytes = np.ascontiguousarray(fixed).view(np.uint8).reshape(-1, 3, 4)[..., :3]
    sh = values["sh"]
    streams = [
        low_bytes,
        _bytes(255 * expit(values["opacity_logits"])),
        _bytes(127.5 + _COLOUR_STEPS * sh[:, 0]),
        _bytes(16 * (values["log_scales"] + 10)),
        _smallest_three(values["quaternions"]),
        _bytes(128 + 128 * sh[:, 1:]),
    ]
    return [stream.tobytes() for stream in streams]


def values_of(streams: list[bytes], count: int, coefficients: int, bits: int) -> dict[str, np.ndarray]:
    """Arrays by the names of `GAUSSIAN_PARAMETERS` from streams of the sizes of `stream_sizes`."""
    positions, opacities, colours, scales, rotations, harmonics = (
        np.frombuffer(stream, np.uint8) for stream in streams
    )
    wide = np.zeros((count, 3, 4), np.uint8)
    wide[..., 1:] = positions.reshape(count, 3, 3)
    fixed = wide.view("<i4")[..., 0] >> 8  # the shift brings the sign along
    base = (colours.reshape(count, 1, 3) - 127.5) / _COLOUR_STEPS
    higher = harmonics.reshape(count, coefficients - 1, 3) / 128.0 - 1
    return {
        "means": fixed / 2.0**bits,
        "quaternions": _from_smallest_three(rotations.reshape(count, 4)),
        "log_scales": scales.reshape(count, 3) / 16 - 10,
        "opacity_logits": logits_of_bytes(opacities),
        "sh": np.concatenate([base, higher], axis=1),
    }


def _bytes(values: np.ndarray) -> np.ndarray:
    """Rounded and clipped to 0 to 255."""
    return np.clip(np.round(values), 0, 255).astype(np.uint8)


def _smallest_three(quaternions: Float[np.ndarray, "n 4"]) -> UInt8[np.ndarray, "n 4"]:
    """Quaternions wxyz in 32 bits, little-endian.

    From the highest bit on: two for the index of the largest component in xyzw, then ten for each of the
    others, sign and magnitude. The largest is made positive and follows from the unit length.
    """
    xyzw = np.roll(quaternions, -1, axis=1)
    rows = np.arange(len(xyzw))
    largest = np.argmax(np.abs(xyzw), axis=1)
    signs = np.where(xyzw[rows, largest] < 0, -1, 1)
    others = xyzw[rows[:, None], _OTHERS[largest]] * signs[:, None]
    magnitudes = np.minimum(np.round(_ROTATION_STEPS * np.abs(others)), 511).astype(np.uint32)
    fields = (others < 0).astype(np.uint32) << 9 | magnitudes
    words = largest.astype(np.uint32) << 30 | fields[:, 0] << 20 | fields[:, 1] << 10 | fields[:, 2]
    return np.ascontiguousarray(words.astype("<u4")).view(np.uint8).reshape(-1, 4)


def _from_smallest_three(packed: UInt8[np.ndarray, "n 4"]) -> Float[np.ndarray, "n 4"]:
    """The inverse of `_smallest_three`."""
    words = np.ascontiguousarray(packed).view("<u4")
    fields = words >> np.asarray([20, 10, 0], np.uint32) & 0x3FF
    others = np.where(fields & 0x200, -1.0, 1.0) * (fields & 0x1FF) / _ROTATION_STEPS
    largest = (words[:, 0] >> 30).astype(np.intp)
    rows = np.arange(len(packed))
    xyzw = np.zeros((len(packed), 4))
    xyzw[rows[:, None], _OTHERS[largest]] = others
    xyzw[rows, largest] = np.sqrt(np.maximum(1 - np.sum(others**2, axis=1), 0))
    return np.roll(xyzw, 1, axis=1)
