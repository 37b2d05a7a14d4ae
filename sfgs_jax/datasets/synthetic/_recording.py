"""A synthetic place as a recording."""

from dataclasses import dataclass, field

import jax
import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets.synthetic._noise import add_noise
from sfgs_jax.datasets.synthetic._places import PLACES
from sfgs_jax.datasets.synthetic._render import render_view
from sfgs_jax.datasets.synthetic._scene import Scene
from sfgs_jax.geometry import Camera, Frame, Trajectory, se3

_FRAMES_PER_SECOND = 30.0
_FIELDS = {"frames": "num_frames", "width": "width", "height": "height", "seed": "seed", "noise": "noise"}


@dataclass(frozen=True)
class SyntheticRecording:
    """A furnished room, or a harder place, ray-cast along a camera's way through it.

    A `Recording` whose frames are rendered when asked for. The same parameters give the same frames, in any
    order.
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
    _scene: Scene = field(init=False, repr=False, compare=False)
    _trajectory: Trajectory = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.place not in PLACES:
            raise InputError(f"There is no synthetic place {self.place!r}; choose from {', '.join(PLACES)}.")
        if self.num_frames < 1 or min(self.width, self.height) < 16 or self.seed < 0:
            raise InputError(
                "A synthetic recording needs at least 1 frame of at least 16x16 pixels, and a seed from 0, "
                f"not {self.num_frames} of {self.width}x{self.height} with seed {self.seed}."
            )
        timestamps = np.arange(self.num_frames, dtype=np.float64) / _FRAMES_PER_SECOND
        scene, poses = PLACES[self.place](self.seed, self.num_frames)
        object.__setattr__(self, "_scene", scene)
        object.__setattr__(self, "_trajectory", Trajectory(timestamps, poses))

    @classmethod
    def parse(cls, source: str) -> "SyntheticRecording":
        """Recording from a string such as `synthetic:place=ring,frames=60,width=160,height=120,seed=1`.

        Raises:
            InputError: an unknown name or place, or another value that is no whole number.
        """
        _, _, text = source.partition(":")
        values: dict[str, int] = {}
        place = "room"
        for item in filter(None, text.split(",")):
            name, _, value = item.partition("=")
            if name.strip() == "place":
                place = value.strip()
                continue
            if name.strip() not in _FIELDS or not value.strip().isdecimal():
                raise InputError(
                    f"{source!r} is not understood at {item!r}; "
                    "write for example synthetic:frames=60,width=160,height=120,seed=1,noise=1."
                )
            values[_FIELDS[name.strip()]] = int(value)
        noise = bool(values.pop("noise", 0))
        return cls(**values, noise=noise, place=place)

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
        return self._scene

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

    def __len__(self) -> int:
        return self.num_frames

    def __getitem__(self, index: int) -> Frame:
        index = range(self.num_frames)[index]
        camera = self.camera
        view = render_view(self._scene, camera, se3.from_matrix(self._trajectory.poses[index]))
        rgb, depth = view.rgb, view.depth
        if self.noise:
            key = jax.random.fold_in(jax.random.key(self.seed), index)
            rgb, depth = add_noise(key, view, camera)
        return Frame(np.asarray(rgb), np.asarray(depth), self._trajectory.timestamps[index].item())
