"""A run that is its own recording: frames rendered from the map at the trajectory's poses."""

import dataclasses
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from sfgs_jax.arrays import FrameError
from sfgs_jax.evaluation import MapRenderer
from sfgs_jax.geometry import Camera, Frame, Trajectory, format_covariances, format_tum
from sfgs_jax.splatting import Gaussians, save_ply

CAMERA = Camera(60.0, 60.0, 31.5, 23.5, width=64, height=48)
NUM_FRAMES = 11
KEYFRAMES = np.asarray([0, 5, 10])


@dataclasses.dataclass
class ListRecording:
    """A recording held in memory."""

    frames: list[Frame | FrameError]
    timestamps: np.ndarray
    ground_truth: Trajectory | None
    name: str = "made <up>"
    dataset: str = "folder"
    camera: Camera = CAMERA
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: int) -> Frame:
        frame = self.frames[index]
        if isinstance(frame, FrameError):
            raise frame
        return frame


def coloured_wall(n: int = 300) -> Gaussians:
    """Opaque blobs on a wall 2 m ahead, wider than the view."""
    rng = np.random.default_rng(0)
    means = np.stack([rng.uniform(-1.5, 1.5, n), rng.uniform(-1.2, 1.2, n), rng.uniform(1.9, 2.1, n)], axis=1)
    return Gaussians(
        means=jnp.asarray(means, jnp.float32),
        quaternions=jnp.asarray(rng.normal(size=(n, 4)), jnp.float32),
        log_scales=jnp.asarray(np.log(rng.uniform(0.05, 0.12, (n, 3))), jnp.float32),
        opacity_logits=jnp.full((n,), 3.0),
        sh=jnp.asarray(rng.uniform(-1.5, 1.5, (n, 1, 3)), jnp.float32),
        valid=jnp.ones(n, bool),
    )


def path() -> Trajectory:
    """A camera that slides along a curve, all the while looking at the wall."""
    angles = np.linspace(0, np.pi, NUM_FRAMES)
    poses = np.tile(np.eye(4), (NUM_FRAMES, 1, 1))
    poses[:, :3, 3] = 0.2 * np.stack([1 - np.cos(angles), np.sin(angles), 0.5 * np.sin(angles)], axis=1)
    return Trajectory(1305031225.123456 + np.arange(NUM_FRAMES) / 30, poses)


def fabricate(folder: Path) -> ListRecording:
    """Write the files of a run into `folder`; its recording shows exactly what the map shows."""
    gaussians, trajectory = coloured_wall(), path()
    (folder / "trajectory.txt").write_text(format_tum(trajectory))
    (folder / "keyframes.txt").write_text(format_tum(trajectory[KEYFRAMES]))
    covariances = 1e-6 * np.arange(NUM_FRAMES)[:, None, None] * np.eye(6)
    (folder / "trajectory_covariance.txt").write_text(format_covariances(trajectory.timestamps, covariances))
    save_ply(folder / "map.ply", gaussians)
    render = MapRenderer(gaussians, CAMERA)
    frames = []
    for pose, time in zip(trajectory.poses, trajectory.timestamps, strict=True):
        output = render(pose)
        depth = np.array(output.depth)
        depth[:, :16] = 0
        frames.append(Frame(np.clip(np.asarray(output.rgb), 0, 1), depth, float(time)))
    # The ground truth's world is another one.
    T_truth_world = np.asarray([[0.0, -1, 0, 3], [1, 0, 0, 4], [0, 0, 1, 5], [0, 0, 0, 1]])
    truth = Trajectory(trajectory.timestamps, T_truth_world @ trajectory.poses)
    return ListRecording(frames, trajectory.timestamps, truth)
