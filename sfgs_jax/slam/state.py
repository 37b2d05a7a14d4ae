"""The state of a run: one pytree, from which the next step follows."""

from dataclasses import dataclass, field

import jaxlie
import numpy as np
from jaxtyping import Array, Float, UInt8

from sfgs_jax.geometry import Camera, Trajectory, se3
from sfgs_jax.slam.config import SlamConfig
from sfgs_jax.slam.frame_log import FrameLog, trajectory_of
from sfgs_jax.slam.gaussian_map import GaussianMap, empty_map
from sfgs_jax.slam.nodes import Edge, Keyframe
from sfgs_jax.slam.observation import Extractor, Observation, load_extractor
from sfgs_jax.slam.pytrees import pytree
from sfgs_jax.splatting import Gaussians


@pytree
@dataclass(frozen=True, eq=False)
class View:
    """Images that the map is optimised against, at the mapping resolution.

    Attributes:
        rgb: (h, w, 3) colours, 0 to 255.
        depth: (h, w) metres, 0 where missing.
        keyframe: number of the keyframe that it belongs to.
        T_keyframe_cam: its pose there.
        frame: number of the frame it was.
    """

    rgb: UInt8[Array | np.ndarray, "h w 3"]
    depth: Float[Array | np.ndarray, "h w"]
    keyframe: int
    T_keyframe_cam: jaxlie.SE3
    frame: int


@pytree
@dataclass(frozen=True, eq=False)
class MapState:
    """The mapper's part of the state.

    Attributes:
        map: the Gaussians and their optimiser.
        views: what the map is optimised against, in the order in which it got them.
        keyframe_poses: (n, 7) where the Gaussians take the keyframes to be, as wxyz_xyz.
        num_steps: optimisation steps done.
        pair_capacity: room for (tile, Gaussian) pairs in a rendering; it grows when a view needs more.
        dropped_seeds: Gaussians for which the map had no room.
    """

    map: GaussianMap
    views: tuple[View, ...]
    keyframe_poses: Float[np.ndarray, "n 7"]
    num_steps: int
    pair_capacity: int
    dropped_seeds: int

    @property
    def num_gaussians(self) -> int:
        """Gaussians in the map."""
        return int(np.sum(self.map.gaussians.valid))


@pytree
@dataclass(frozen=True, eq=False)
class SlamState:
    """Everything a run knows; each field is replaced, never changed in place.

    Attributes:
        config: settings; static.
        camera: intrinsics of the frames.
        extractor: weights of the keypoint network, None without one.
        keyframes: nodes of the graph, oldest first.
        edges: registrations of keyframes to each other.
        pending: pairs (target, source) of keyframes still to be registered, the next one first.
        candidates: loops that are not believed yet.
        reference: number of the keyframe that frames are registered to.
        T_reference_cam: pose there of the newest tracked frame.
        T_previous_current: motion between the two newest tracked frames.
        last: what that frame showed, if it could be a keyframe and is none: a bridge to a frame that shares
            too little with the reference.
        num_coasting: frames in a row that the motion model had a part in.
        coasted: how far it moved the camera over these, metres or radians, the larger.
        log: where the tracked frames were.
        num_frames: frames seen.
        num_lost: frames that were not found.
        last_view: number of the newest frame that became a view of the map.
        num_landmarks: landmarks numbered so far.
        mapping: the map and its views.
    """

    config: SlamConfig = field(metadata={"static": True})
    camera: Camera
    extractor: Extractor
    keyframes: tuple[Keyframe, ...]
    edges: tuple[Edge, ...]
    pending: tuple[tuple[int, int], ...]
    candidates: tuple[Edge, ...]
    reference: int
    T_reference_cam: jaxlie.SE3
    T_previous_current: jaxlie.SE3
    last: Observation | None
    num_coasting: int
    coasted: float
    log: FrameLog
    num_frames: int
    num_lost: int
    last_view: int
    num_landmarks: int
    mapping: MapState

    @property
    def T_world_cam(self) -> jaxlie.SE3:
        """Pose of the newest tracked frame; the identity before the first."""
        if not self.keyframes:
            return self.T_reference_cam
        return se3.compose(self.keyframes[self.reference].T_world_cam, self.T_reference_cam)

    @property
    def gaussians(self) -> Gaussians:
        """The map."""
        return self.mapping.map.gaussians

    @property
    def loops(self) -> tuple[Edge, ...]:
        """Registrations that tie a place met again to what was there before, however small the drift was."""
        gap = self.config.graph.loop_gap
        return tuple(edge for edge in self.edges if edge.loop or edge.source - edge.target > gap)

    @property
    def mapping_factor(self) -> int:
        """Whole factor by which mapping reduces the images."""
        return max(1, -(-self.camera.width // self.config.mapping.max_width))

    @property
    def mapping_camera(self) -> Camera:
        """Intrinsics of the reduced images."""
        return self.camera.downscaled(self.mapping_factor)

    @property
    def keyframe_poses(self) -> Float[np.ndarray, "n 7"]:
        """(n, 7) `T_world_cam` of the keyframes as wxyz_xyz."""
        return np.asarray([k.T_world_cam.wxyz_xyz for k in self.keyframes], np.float32).reshape(-1, 7)

    @property
    def trajectory(self) -> Trajectory:
        """Poses of the tracked frames, by where their keyframes are now."""
        return trajectory_of(self.log, self.keyframes, self.edges)


def init(camera: Camera, config: SlamConfig | None = None) -> SlamState:
    """The state before the first frame, whose camera will be the world frame.

    Args:
        camera: intrinsics of the frames; their size is fixed for the run.
        config: settings.
    """
    config = config or SlamConfig()
    empty = FrameLog(np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 7), np.float32))
    return SlamState(
        config=config,
        camera=camera,
        extractor=load_extractor(config.tracking.features),
        keyframes=(),
        edges=(),
        pending=(),
        candidates=(),
        reference=0,
        T_reference_cam=se3.identity(),
        T_previous_current=se3.identity(),
        last=None,
        num_coasting=0,
        coasted=0.0,
        log=empty,
        num_frames=0,
        num_lost=0,
        last_view=0,
        num_landmarks=0,
        mapping=MapState(
            map=empty_map(config.mapping.capacity),
            views=(),
            keyframe_poses=np.zeros((0, 7), np.float32),
            num_steps=0,
            pair_capacity=config.mapping.pair_capacity,
            dropped_seeds=0,
        ),
    )
