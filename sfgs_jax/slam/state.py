"""The state of a run: one pytree, from which the next step follows."""

import equinox as eqx
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Float, UInt8

from sfgs_jax.geometry import Camera, se3
from sfgs_jax.gicp import OrganisedCloud
from sfgs_jax.slam.config import SlamConfig
from sfgs_jax.slam.gaussian_map import GaussianMap, empty_map


class Keyframe(eqx.Module):
    """A view that the map is optimised against, at the mapping resolution.

    Attributes:
        rgb: (h, w, 3) colours, 0 to 255.
        depth: (h, w) metres, 0 where missing.
        T_world_cam: its pose.
        index: number of the frame it was.
    """

    rgb: UInt8[Array, "h w 3"]
    depth: Float[Array, "h w"]
    T_world_cam: jaxlie.SE3
    index: int


class Reference(eqx.Module):
    """A keyframe that frames are registered to.

    Attributes:
        cloud: its prepared depth image.
        T_world_cam: its pose.
    """

    cloud: OrganisedCloud
    T_world_cam: jaxlie.SE3


class SlamState(eqx.Module):
    """Everything a run knows; each field is replaced, never changed in place.

    Attributes:
        config: settings; static.
        camera: intrinsics of the frames.
        T_world_cam: pose of the newest tracked frame.
        T_previous_current: motion between the two newest tracked frames.
        references: the tracker's newest keyframes, oldest first; the next frame is registered to the last.
        map: the Gaussians and their optimiser.
        keyframes: mapping keyframes, oldest first.
        num_frames: frames seen.
        num_steps: optimisation steps done.
        pair_capacity: room for (tile, Gaussian) pairs in a rendering; it grows when a view needs more.
    """

    config: SlamConfig = eqx.field(static=True)
    camera: Camera
    T_world_cam: jaxlie.SE3
    T_previous_current: jaxlie.SE3
    references: tuple[Reference, ...]
    map: GaussianMap
    keyframes: tuple[Keyframe, ...]
    num_frames: int
    num_steps: int
    pair_capacity: int

    @property
    def num_gaussians(self) -> int:
        """Gaussians in the map."""
        return int(jnp.sum(self.map.gaussians.valid))

    @property
    def mapping_factor(self) -> int:
        """Whole factor by which mapping reduces the images."""
        return max(1, -(-self.camera.width // self.config.mapping.max_width))

    @property
    def mapping_camera(self) -> Camera:
        """Intrinsics of the reduced images."""
        return self.camera.downscaled(self.mapping_factor)


def init(camera: Camera, config: SlamConfig | None = None) -> SlamState:
    """The state before the first frame, whose camera will be the world frame.

    Args:
        camera: intrinsics of the frames; their size is fixed for the run.
        config: settings.
    """
    config = config or SlamConfig()
    return SlamState(
        config=config,
        camera=camera,
        T_world_cam=se3.identity(),
        T_previous_current=se3.identity(),
        references=(),
        map=empty_map(config.mapping.capacity),
        keyframes=(),
        num_frames=0,
        num_steps=0,
        pair_capacity=config.mapping.pair_capacity,
    )
