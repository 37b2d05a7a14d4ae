"""The mapper's part of a run's state: Gaussians, views, and where the keyframes were."""

from dataclasses import dataclass

import jaxlie
import numpy as np
from jaxtyping import Array, Bool, Float, UInt8

from sfgs_jax.arrays import Text, bucket, printed_fields, printed_length, pytree
from sfgs_jax.slam.config import MappingConfig
from sfgs_jax.slam.state._gaussian_map import GaussianMap, empty_map
from sfgs_jax.slam.state._submaps import Submap, with_submaps

_PAIRS_PER_PIXEL = 1.7
"""Room for pairs at first: what views of a furnished room need once they are covered twice over."""
_SEEN_PER_PIXEL = 0.2
"""Room for Gaussians in view at first, for each pixel of a view."""


@pytree
@dataclass(frozen=True, eq=False)
class View:
    """Images that the map is optimised against.

    Attributes:
        rgb: (h, w, 3) colours, 0 to 255.
        depth: (h, w) metres, 0 where missing.
        valid: (h, w) pixels that hold an image.
        twist: (6,) motion of the camera per second in its own frame; zeros where it is not known.
        keyframe: number of the keyframe that it belongs to.
        T_keyframe_cam: its pose there.
        frame: its number in its source.
        gain: (3,) of each channel against the map's colours, as last fitted; see `sensors.fitted_gain`.
        correction: (6,) tangent by which its image has moved its pose, on the right; see `corrections_of`.
        extra: whether it is kept for the refinement alone, and sets no Gaussians before that.
    """

    rgb: UInt8[Array | np.ndarray, "h w 3"]
    depth: Float[Array | np.ndarray, "h w"]
    valid: Bool[Array | np.ndarray, "h w"]
    twist: Float[Array | np.ndarray, "6"]
    keyframe: int
    T_keyframe_cam: jaxlie.SE3
    frame: int
    gain: Float[Array | np.ndarray, "3"]
    correction: Float[Array | np.ndarray, "6"]
    extra: bool

    def __repr__(self) -> str:
        return printed_fields("View", frame=self.frame, keyframe=self.keyframe, rgb=self.rgb)


@pytree
@dataclass(frozen=True, eq=False)
class MapState:
    """The map while it grows.

    Attributes:
        map: the Gaussians and their optimiser.
        views: images that the map is optimised against, in the order in which they were inserted.
        keyframe_poses: (n, 7) `T_world_cam` of the keyframes that the Gaussians agree with, as wxyz_xyz.
        times: (3,) of the camera's rows as they were last estimated, in the order of `SensorTiming`, seconds;
            None if images count as taken at once.
        num_steps: map steps done.
        pair_capacity: pairs of tile and Gaussian that a rendering has room for.
        view_capacity: Gaussians in view that a rendering has room for.
        dropped_seeds: Gaussians for which the map had no room.
        submaps: Gaussians of far places, which are not rendered now.
        num_submaps: submaps made so far, those that came back among them.
    """

    map: GaussianMap
    views: tuple[View, ...]
    keyframe_poses: Float[np.ndarray, "n 7"]
    times: Float[np.ndarray, "3"] | None
    num_steps: int
    pair_capacity: int
    view_capacity: int
    dropped_seeds: int
    submaps: tuple[Submap, ...]
    num_submaps: int

    def __repr__(self) -> str:
        return printed_fields(
            "MapState",
            gaussians=Text(repr(self.map.gaussians)),
            views=Text(printed_length(self.views)),
            num_steps=self.num_steps,
        )

    @property
    def num_gaussians(self) -> int:
        """Gaussians in the map and in its submaps."""
        return int(np.sum(self.map.gaussians.valid)) + sum(len(submap) for submap in self.submaps)

    @property
    def whole(self) -> GaussianMap:
        """The map with the Gaussians of all submaps; it may be larger than the map has room for."""
        return with_submaps(self.map, self.submaps, self.keyframe_poses)


def empty_map_state(config: MappingConfig, *, pixels: int, timed: bool) -> MapState:
    """The map before the first frame.

    Args:
        config: settings.
        pixels: of a view.
        timed: whether the times of the camera's rows are estimated.
    """
    return MapState(
        map=empty_map(config.capacity),
        views=(),
        keyframe_poses=np.zeros((0, 7), np.float32),
        times=np.zeros(3, np.float32) if timed else None,
        num_steps=0,
        pair_capacity=config.pair_capacity or bucket(int(_PAIRS_PER_PIXEL * pixels), steps=2, smallest=1024),
        view_capacity=bucket(int(_SEEN_PER_PIXEL * pixels), steps=1, smallest=1024),
        dropped_seeds=0,
        submaps=(),
        num_submaps=0,
    )
