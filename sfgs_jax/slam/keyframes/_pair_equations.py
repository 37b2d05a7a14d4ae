"""Equations of the camera after a registration of two keyframes."""

from dataclasses import dataclass

from sfgs_jax.slam.keyframes._depth_equations import DepthEquations, depth_equations
from sfgs_jax.slam.keyframes._focal_lengths import focal_lengths_by
from sfgs_jax.slam.state._focal_information import FocalInformation
from sfgs_jax.slam.state._frame_features import FrameFeatures
from sfgs_jax.slam.state._registration import BY_KEYPOINTS, Registration
from sfgs_jax.slam.state._tracker import TrackerParams


@dataclass(frozen=True, eq=False)
class PairEquations:
    """A registration's equations of what is the same for all frames.

    Attributes:
        focal: of the focal lengths; says nothing where no keypoints took part.
        depth: of the errors of depth; None where depth is not corrected.
    """

    focal: FocalInformation
    depth: DepthEquations | None


def pair_equations(
    params: TrackerParams, source: FrameFeatures, target: FrameFeatures, found: Registration
) -> PairEquations:
    """Equations after a registration.

    Args:
        params: parameters of tracking; both frames have its correction of depth.
        source: the frame that was registered.
        target: the frame that it was registered to.
        found: the registration.
    """
    frames = source, target
    by_keypoints = int(found.source) in BY_KEYPOINTS
    return PairEquations(
        focal_lengths_by(params, *frames, found) if by_keypoints else FocalInformation(),
        None if params.depth_correction is None else depth_equations(params, *frames, found),
    )
