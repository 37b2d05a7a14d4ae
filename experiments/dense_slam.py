"""A peer on the same recordings: Open3D's dense SLAM, which tracks every frame in a fused volume.

    python -m experiments.dense_slam [--recordings redkitchen fr1_rpy] [--end FRAME]

Frames, depth in the colour camera's view, and the recording's poses are those that the system gets, and ATE
is measured alike. Volume and limits are those of Open3D's own example. Needs open3d.
"""

import time
from typing import Literal

import numpy as np
import open3d as o3d  # pyright: ignore[reportMissingImports]
import tyro

from experiments.matching_tables import print_table
from experiments.recordings import SOURCES
from sfgs_jax.arrays import FrameError
from sfgs_jax.datasets import ReaderOptions, Recording, open_recording, prefetch
from sfgs_jax.datasets.files import depth_units
from sfgs_jax.evaluation import ate
from sfgs_jax.geometry import Trajectory

VOXEL = 3.0 / 512
"""Side of a voxel, metres."""
BLOCKS = 40_000
"""Blocks of 16 x 16 x 16 voxels that there is room for."""
UNITS_PER_METRE = 1000.0
MIN_DEPTH, MAX_DEPTH = 0.1, 5.0
MAX_STEP = 0.07
"""A pixel whose depth is off by more than this takes no part in the tracking, metres."""
TRUNCATION = 8.0
"""Voxels."""
COLUMNS = ("recording", "frames", "ATE cm", "frames/s")


def dense_trajectory(recording: Recording) -> Trajectory:
    """Poses of all frames that can be read."""
    device, camera = o3d.core.Device("CPU:0"), recording.camera
    K = o3d.core.Tensor.from_numpy(np.asarray(camera.matrix(), np.float64))
    seen, shown = (o3d.t.pipelines.slam.Frame(*camera.shape, K, device) for _ in range(2))
    T = np.eye(4)
    model = o3d.t.pipelines.slam.Model(VOXEL, 16, BLOCKS, o3d.core.Tensor.from_numpy(T), device)
    poses, timestamps = [], []
    for _, frame in prefetch(recording):
        if isinstance(frame, FrameError):
            continue
        seen.set_data_from_image("depth", _image(depth_units(np.asarray(frame.depth), UNITS_PER_METRE)))
        seen.set_data_from_image("color", _image((255 * np.asarray(frame.rgb)).astype(np.uint8)))
        if poses:
            found = model.track_frame_to_model(seen, shown, UNITS_PER_METRE, MAX_DEPTH, MAX_STEP)
            T = T @ found.transformation.numpy()
        model.update_frame_pose(len(poses), o3d.core.Tensor.from_numpy(T))
        model.integrate(seen, UNITS_PER_METRE, MAX_DEPTH, TRUNCATION)
        model.synthesize_model_frame(shown, UNITS_PER_METRE, MIN_DEPTH, MAX_DEPTH, TRUNCATION, False)
        poses.append(T)
        timestamps.append(float(frame.timestamp))
    return Trajectory(np.asarray(timestamps), np.asarray(poses))


def _image(array: np.ndarray) -> o3d.t.geometry.Image:
    return o3d.t.geometry.Image(o3d.core.Tensor.from_numpy(np.ascontiguousarray(array)))


def main(
    recordings: tuple[Literal["redkitchen", "fr1_rpy"], ...] = ("redkitchen", "fr1_rpy"),
    end: int | None = None,
) -> None:
    """Tracks each recording and prints the table.

    Args:
        recordings: names.
        end: frame before which to stop; the last if not given.
    """
    rows = []
    for name in recordings:
        recording = open_recording(SOURCES[name], options=ReaderOptions(end=end))
        assert recording.ground_truth is not None, "all of these come with poses"
        start = time.perf_counter()
        trajectory = dense_trajectory(recording)
        seconds = time.perf_counter() - start
        error = 100 * ate(trajectory, recording.ground_truth).rmse_m
        rows.append((name, str(len(trajectory)), f"{error:.2f}", f"{len(trajectory) / seconds:.1f}"))
    print_table("Open3D's dense SLAM", COLUMNS, rows)


if __name__ == "__main__":
    tyro.cli(main)
