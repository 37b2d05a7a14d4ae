"""Results of a step, and the stages that it is timed by."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import NamedTuple

import jaxlie
import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import Text, printed_fields
from sfgs_jax.geometry import se3
from sfgs_jax.slam.state._registration import PoseSource

Stages = Callable[[str], AbstractContextManager[None]]
"""Gives a context for the name of a stage, which times the stage."""


def untimed(name: str) -> AbstractContextManager[None]:
    """A stage that nobody times.

    Args:
        name: of the stage.
    """
    return nullcontext()


class StepInfo(NamedTuple):
    """What happened in a step.

    Attributes:
        T_world_cam: the frame's pose; the last known one where it was lost.
        covariance: (6, 6) of its tangent on the right, translation first, metres and radians; infinite where
            the frame was lost.
        tracked: whether that pose is known.
        source: residuals that it rests on.
        relocalised: whether the frame was found by its looks, after it or those before it had been lost.
        new_keyframe: whether the frame became a keyframe.
        new_map: whether the frame begins another map, because those before it fit no known place.
        new_view: whether the frame became a view of the map.
        loop_closed: whether a loop was closed in this step.
        inlier_fraction: share of the frame's points that lie on the reference's surface, but for those at its
            holes.
        rmse: root mean square distance of those, metres.
        num_matches: keypoints matched with the reference's.
        num_inliers: matches that agree with the motion found.
        loss: of the map on the view last rendered, before the step on it; NaN if none was.
        contradiction: why the frame was not believed, if its depth contradicts its colour or the frames
            before; otherwise empty.
    """

    T_world_cam: jaxlie.SE3
    covariance: Float[np.ndarray, "6 6"]
    tracked: bool
    source: PoseSource
    relocalised: bool
    new_keyframe: bool
    new_map: bool
    new_view: bool
    loop_closed: bool
    inlier_fraction: float
    rmse: float
    num_matches: int
    num_inliers: int
    loss: float
    contradiction: str = ""

    def __repr__(self) -> str:
        happened = ("relocalised", "new_keyframe", "new_map", "new_view", "loop_closed")
        return printed_fields(
            "StepInfo",
            tracked=self.tracked,
            source=self.source,
            T_world_cam=Text(se3.text_of(self.T_world_cam)),
            rmse=(self.rmse, "m"),
            inlier_fraction=self.inlier_fraction,
            matches=Text(f"{self.num_inliers} of {self.num_matches}"),
            **{name: True for name in happened if getattr(self, name)},
        )


def lost_info(T_world_cam: jaxlie.SE3) -> StepInfo:
    """The report of a frame that was lost unseen.

    Args:
        T_world_cam: the last known pose.
    """
    return StepInfo(
        T_world_cam=T_world_cam,
        covariance=np.diag(np.full(6, np.inf)),
        tracked=False,
        source=PoseSource.LOST,
        relocalised=False,
        new_keyframe=False,
        new_map=False,
        new_view=False,
        loop_closed=False,
        inlier_fraction=0.0,
        rmse=0.0,
        num_matches=0,
        num_inliers=0,
        loss=float("nan"),
    )
