"""A synthetic place as a recording."""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Float, Shaped

from sfgs_jax.arrays import InputError, excerpt
from sfgs_jax.datasets.synthetic._kinect_faults import KINECT_V1, KinectFaults, row_delays
from sfgs_jax.datasets.synthetic._noise import add_noise
from sfgs_jax.datasets.synthetic._path import poses_between
from sfgs_jax.datasets.synthetic._places import PLACES, Place
from sfgs_jax.datasets.synthetic._render import IdealView, render_view
from sfgs_jax.datasets.synthetic._rolling_shutter import colour_by_rows, depth_by_rows
from sfgs_jax.datasets.synthetic._scene import Scene
from sfgs_jax.geometry import Camera, Frame, Trajectory, se3

_FRAMES_PER_SECOND = 30.0
_FIELDS = {
    "frames": "num_frames",
    "width": "width",
    "height": "height",
    "seed": "seed",
    "noise": "noise",
    "kinect": "kinect",
}
_LARGEST = {"num_frames": 1_000_000, "width": 8192, "height": 8192, "seed": (1 << 31) - 1}


@dataclass(frozen=True)
class SyntheticRecording:
    """A furnished room, or a harder place, ray-cast along a camera's way through it.

    A `Recording` whose frames are rendered when asked for. The same parameters give the same frames, in any
    order.

    Poses are exact whatever the faults. A pose is the colour camera's at the middle of the exposure of the
    image's middle row, which is the frame's time stamp.
    """

    num_frames: int = 120
    """Number of frames, 30 a second."""
    width: int = 320
    """Image width, pixels."""
    height: int = 240
    """Image height, pixels."""
    seed: int = 0
    """Seed of the place's colours and furniture, and of the noise."""
    noise: bool = False
    """True adds the noise of a Kinect; without it images are ideal."""
    place: str = "room"
    """Name of the place, one of `PLACES`; docs/datasets.md describes them."""
    faults: KinectFaults | None = None
    """Systematic faults of the camera, such as `KINECT_V1`; None for none."""
    _place: Place = field(init=False, repr=False, compare=False)
    _trajectory: Trajectory = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.place not in PLACES:
            raise InputError(f"There is no synthetic place {self.place!r}; choose from {', '.join(PLACES)}.")
        if self.num_frames < 1 or min(self.width, self.height) < 16 or self.seed < 0:
            raise InputError(
                "A synthetic recording needs at least 1 frame of at least 16x16 pixels, and a seed from 0, "
                f"not {self.num_frames} of {self.width}x{self.height} with seed {self.seed}."
            )
        for name, largest in _LARGEST.items():
            if getattr(self, name) > largest:
                raise InputError(
                    f"{name} of a synthetic recording is at most {largest}, "
                    f"not {excerpt(getattr(self, name))}."
                )
        timestamps = np.arange(self.num_frames, dtype=np.float64) / _FRAMES_PER_SECOND
        place = PLACES[self.place](self.seed, self.num_frames)
        object.__setattr__(self, "_place", place)
        object.__setattr__(self, "_trajectory", Trajectory(timestamps, place.poses))

    @classmethod
    def parse(cls, source: str) -> "SyntheticRecording":
        """Recording from a string such as `synthetic:place=ring,frames=60,width=160,height=120,seed=1`.

        `kinect=1` stands for `KINECT_V1` with noise; `kinect=1,noise=0` leaves the noise out.

        Raises:
            InputError: it does not begin so, has an unknown name or place, or another value that is no whole
                number.
        """
        kind, _, text = source.partition(":")
        if kind != "synthetic":
            raise InputError(f"{excerpt(source)} is no synthetic recording: its name begins with synthetic.")
        values: dict[str, int] = {}
        place = "room"
        for item in filter(None, text.split(",")):
            name, _, value = item.partition("=")
            if name.strip() == "place":
                place = value.strip()
                continue
            if name.strip() not in _FIELDS or not value.strip().isdecimal() or len(value) > 20:
                raise InputError(
                    f"{excerpt(source)} is not understood at {excerpt(item)}; "
                    "write for example synthetic:frames=60,width=160,height=120,seed=1,noise=1."
                )
            values[_FIELDS[name.strip()]] = int(value)
        kinect = values.pop("kinect", 0)
        noise = bool(values.pop("noise", kinect))
        return cls(**values, noise=noise, place=place, faults=KINECT_V1 if kinect else None)

    @property
    def name(self) -> str:
        """Always "synthetic"."""
        return "synthetic"

    @property
    def dataset(self) -> str:
        """Layout name."""
        return "synthetic"

    @property
    def camera(self) -> Camera:
        """A camera with the field of view of a Kinect (63 degrees)."""
        focal = 0.82 * self.width
        return Camera(
            focal, focal, (self.width - 1) / 2, (self.height - 1) / 2, width=self.width, height=self.height
        )

    @property
    def scene(self) -> Scene:
        """The triangles and textures of the place."""
        return self._place.scene

    @property
    def timestamps(self) -> Float[np.ndarray, " n"]:
        """Time of each frame in seconds, float64."""
        return self._trajectory.timestamps

    @property
    def ground_truth(self) -> Trajectory:
        """Exact poses, all of them."""
        return self._trajectory

    @property
    def notes(self) -> tuple[str, ...]:
        """No warnings."""
        return ()

    @property
    def depth_timestamps(self) -> Float[np.ndarray, " n"]:
        """Time at which the middle row of each frame's depth is exposed, seconds, float64."""
        return self.timestamps + self._faults.depth_delay

    @property
    def gains(self) -> Float[np.ndarray, " n"]:
        """Factor on each frame's colour."""
        return self._faults.gain(self.timestamps)

    @property
    def T_colour_depth(self) -> Float[np.ndarray, "4 4"]:
        """Pose in the colour camera of the depth camera, whose images pass for the colour camera's own.

        A frame's depth gives points of the depth camera. This motion takes them to the colour camera.
        """
        return self._faults.T_colour_depth(self.seed)

    @property
    def inverse_depth_offsets(self) -> Float[np.ndarray, "h w"]:
        """The bands: each pixel's error of inverse depth, 1/m, the same in all frames.

        Depth z is measured as 1 / (1 / z + offset), before noise.
        """
        return self._faults.inverse_depth_offsets(self.camera, self.seed)

    def poses_at(self, times: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 4 4"]:
        """Exact `T_world_cam` of the colour camera at any time in seconds."""
        return se3.matrices_of(poses_between(self._trajectory, times, np.eye(4)))

    @property
    def _faults(self) -> KinectFaults:
        return self.faults or KinectFaults()

    def __len__(self) -> int:
        return self.num_frames

    def __getitem__(self, index: int) -> Frame:
        index = range(self.num_frames)[index]
        view = self._view_with_faults(index) if self._faults.any() else self._ideal_view(index)
        rgb, depth = view.rgb, view.depth
        if self.noise:
            key = jax.random.fold_in(jax.random.key(self.seed), index)
            rgb, depth = add_noise(key, view, self.camera)
        return Frame(
            np.asarray(rgb),
            np.asarray(depth),
            self.timestamps[index].item(),
            depth_timestamp=self.depth_timestamps[index].item(),
        )

    def _ideal_view(self, index: int) -> IdealView:
        return render_view(self._scene_at(index), self.camera, se3.from_matrix(self._trajectory.poses[index]))

    def _scene_at(self, index: int) -> Scene:
        """The part of the place that a frame may see."""
        part = self._place.part
        return self.scene if part is None else part(self._trajectory.positions[index])

    def _view_with_faults(self, index: int) -> IdealView:
        """The images but for noise: every row seen from where the camera is at its time."""
        faults, camera, height = self._faults, self.camera, self.height
        still = np.eye(4)
        middles = self.timestamps[index] + faults.sub_exposures()
        centres, corners = np.arange(height), np.arange(height + 1) - 0.5
        scene = self._scene_at(index)
        rgb = colour_by_rows(
            scene,
            camera,
            self._row_poses(middles, centres, faults.colour_readout, still),
            self._row_poses(middles, corners, faults.colour_readout, still),
        )
        middle = self.depth_timestamps[index : index + 1]
        poses = self._row_poses(middle, centres, faults.depth_readout, self.T_colour_depth)
        depth, facing = depth_by_rows(scene, camera, jax.tree.map(lambda x: x[0], poses))
        inverse = 1 / jnp.where(depth > 0, depth, 1) + jnp.asarray(self.inverse_depth_offsets, jnp.float32)
        return IdealView(
            rgb=jnp.clip(rgb * self.gains[index].item(), 0, 1),
            depth=jnp.where((depth > 0) & (inverse > 0), 1 / inverse, 0),
            facing=facing,
        )

    def _row_poses(
        self,
        middles: Float[np.ndarray, " k"],
        rows: Shaped[np.ndarray, " r"],
        readout: float,
        T_colour_sensor: Float[np.ndarray, "4 4"],
    ) -> jaxlie.SE3:
        """(k, r) poses of a sensor at the times of rows, of images whose middle row is at given times."""
        times = middles[:, None] + row_delays(rows.astype(np.float64), self.height, readout)
        poses = poses_between(self._trajectory, times.ravel(), T_colour_sensor)
        return jaxlie.SE3(jnp.asarray(poses.reshape(*times.shape, 7), jnp.float32))
