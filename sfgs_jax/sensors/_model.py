"""Model of a camera: the times of its rows, and the distortion of its depth."""

import equinox as eqx

from sfgs_jax.sensors._depth_correction import DepthCorrection
from sfgs_jax.sensors._timing import SensorTiming


class SensorModel(eqx.Module):
    """Model of an RGB-D camera, as far as it is known.

    Attributes:
        timing: times of the rows; None where they are not known.
        depth: correction of depth; None where it is not known.
    """

    timing: SensorTiming | None = None
    depth: DepthCorrection | None = None
