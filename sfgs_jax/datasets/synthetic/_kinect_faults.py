"""Systematic faults of a Kinect, and the exact functions of time and pixel that they stand for."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from sfgs_jax.arrays import check_positive, check_range
from sfgs_jax.geometry import Camera

BAND_DEPTH = 2.0
"""Depth at which the amplitude of the bands is given, metres."""
NUM_EXPOSURES = 5
"""Instants that motion blur is the mean of."""
_FRAME_INTERVAL = 1 / 30
_BAND_PERIODS = (1.0, 2.0, 3.0)
_BAND_WEIGHTS = (0.5, 1.0, 0.5)
_BAND_TILT = 0.1
"""Shift of the bands between the middle and the last row, in periods."""
_EXTRINSIC_STREAM, _BAND_STREAM = 1, 2
"""Random streams of a seed, other than the place's own."""


@dataclass(frozen=True)
class KinectFaults:
    """Faults of a structured-light camera that repeat from frame to frame; each is off at 0.

    `KINECT_V1` has those of a Kinect. The seed of the recording draws the pattern of the bands and the
    directions of the extrinsic error, so another seed is another camera. Random noise is not among them: it
    is the recording's setting `noise`.
    """

    depth_bands: float = 0.0
    """Largest error of depth at 2 m, metres, in smooth vertical bands; it grows with depth squared."""
    depth_delay: float = 0.0
    """Time from colour's middle row to depth's, seconds; negative if depth is exposed first."""
    colour_readout: float = 0.0
    """Time from the exposure of colour's first row to that of its last, seconds."""
    depth_readout: float = 0.0
    """Time from the exposure of depth's first row to that of its last, seconds."""
    exposure_time: float = 0.0
    """Time for which each row of colour is exposed, seconds; motion blurs it."""
    gain_amplitude: float = 0.0
    """Amplitude of colour's gain, which is 1 + amplitude * sin(2 pi t / period); 0.2 gives 0.8 to 1.2."""
    gain_period: float = 4.0
    """Period of the gain, seconds."""
    extrinsic_shift: float = 0.0
    """Length of the translation that the registration of depth to colour leaves out, metres."""
    extrinsic_turn: float = 0.0
    """Angle of the rotation that the registration of depth to colour leaves out, radians."""

    def __post_init__(self) -> None:
        """Refuse values that have no meaning."""
        check_range(self, 0, 0.2, "depth_bands")
        check_range(self, -0.1, 0.1, "depth_delay")
        check_range(self, 0, _FRAME_INTERVAL, "colour_readout", "depth_readout", "exposure_time")
        check_range(self, 0, 0.9, "gain_amplitude")
        check_positive(self, "gain_period")
        check_range(self, 0, 0.1, "extrinsic_shift", "extrinsic_turn")

    def any(self) -> bool:
        """True if one of them is turned on."""
        return self != KinectFaults(gain_period=self.gain_period)

    def gain(self, times: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Factor on colour at times in seconds."""
        return 1 + self.gain_amplitude * np.sin(2 * np.pi / self.gain_period * times)

    def sub_exposures(self) -> Float[np.ndarray, " k"]:
        """Instants that an exposure is the mean of, relative to its middle, seconds."""
        if self.exposure_time == 0:
            return np.zeros(1)
        return self.exposure_time * ((np.arange(NUM_EXPOSURES) + 0.5) / NUM_EXPOSURES - 0.5)

    def T_colour_depth(self, seed: int) -> Float[np.ndarray, "4 4"]:
        """Pose of the depth camera in the colour camera, which registration takes to be the identity."""
        directions = np.random.default_rng([seed, _EXTRINSIC_STREAM]).normal(size=(2, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        shift, turn = self.extrinsic_shift * directions[0], self.extrinsic_turn * directions[1]
        T = np.eye(4)
        T[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
        T[:3, 3] = shift
        return T

    def inverse_depth_offsets(self, camera: Camera, seed: int) -> Float[np.ndarray, "h w"]:
        """The bands as errors of inverse depth, 1/m: depth z is measured as 1 / (1 / z + offset)."""
        phases = np.random.default_rng([seed, _BAND_STREAM]).uniform(0, 2 * np.pi, len(_BAND_PERIODS))
        u, v = np.meshgrid(np.linspace(0, 1, camera.width), np.linspace(-1, 1, camera.height))
        pattern = sum(
            weight * np.cos(2 * np.pi * (periods * u + _BAND_TILT * v) + phase)
            for weight, periods, phase in zip(_BAND_WEIGHTS, _BAND_PERIODS, phases, strict=True)
        )
        return self.depth_bands / BAND_DEPTH**2 * pattern / np.abs(pattern).max()


def row_delays(rows: Float[np.ndarray, " n"], height: int, readout: float) -> Float[np.ndarray, " n"]:
    """Rolling shutter: time of rows relative to the middle row, seconds.

    Args:
        rows: row coordinates; halves lie between two rows.
        height: rows of the image.
        readout: seconds from the first row to the last.
    """
    return readout * (rows / (height - 1) - 0.5)


KINECT_V1 = KinectFaults(
    depth_bands=0.010,
    depth_delay=0.015,
    colour_readout=0.030,
    depth_readout=0.025,
    exposure_time=0.020,
    gain_amplitude=0.2,
    extrinsic_shift=0.010,
    extrinsic_turn=math.radians(0.3),
)
"""Faults of a first Kinect, of the size found in recordings.

Bands: -13 to +7 mm at 2 m in 7-Scenes' RedKitchen; Herrera, Kannala and Heikkilä, Joint Depth and Color
Camera Calibration with Distortion Correction, 2012. Delay: the two streams run freely, so up to half a frame;
TUM's fr1_rpy has 8 ms by its stamps, up to 17. Readout: colour about 30 ms and depth 15 to 30 ms in fr1_rpy.
Both sensors have rolling shutters: Ringaby and Forssén, Scan Rectification for Structured Light Range Sensors
with Rolling Shutters, 2011. Exposure, gain and extrinsics are assumed: indoor light, automatic exposure,
and the error of a calibration that was done once for all Kinects.
"""
