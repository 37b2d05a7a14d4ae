"""Registration of depth images: time and error on RedKitchen, beside small_gicp and Open3D if installed.

    python -m benchmarks.gicp [frames apart ...].

Reads the recordings below SFGS_DATA, else ../shared. Times are medians after warm-up, from a depth image on
the host to a pose. Errors are against the poses given with the recording, which are good to about a
centimetre. All starts are the identity. Compare columns of one run: absolute times depend on the machine.
A stage of 0 ms is part of the next: only small_gicp takes points.
"""

import importlib
import importlib.util
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import jax
import numpy as np
from rich.console import Console
from rich.table import Table

from sfgs_jax import Camera
from sfgs_jax.arrays import InputError
from sfgs_jax.geometry import se3
from sfgs_jax.gicp import align, prepare

CAMERA = Camera(585.0, 585.0, 320.0, 240.0, width=640, height=480)
GAPS = (1, 5, 10)
STARTS = range(0, 580, 12)

STAGES = ("points", "prepare", "align")

Stages = dict[str, float]
Registration = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, Stages]]


def data_root() -> Path:
    root = Path(os.environ.get("SFGS_DATA", Path(__file__).parents[2] / "shared"))
    if not (root / "data" / "7scenes" / "redkitchen").is_dir():
        raise InputError(f"No 7-Scenes RedKitchen at {root}; set SFGS_DATA to the folder that holds data/.")
    return root


def load(folder: Path, index: int) -> tuple[np.ndarray, np.ndarray]:
    raw = cv2.imread(str(folder / f"frame-{index:06d}.depth.png"), cv2.IMREAD_UNCHANGED)
    if raw is None:
        raise InputError(f"Cannot read depth image {index} of {folder}.")
    depth = np.where(raw == 65535, 0, raw).astype(np.float32) / 1000
    return depth, np.loadtxt(folder / f"frame-{index:06d}.pose.txt")


def motion_error(found: np.ndarray, given: np.ndarray) -> tuple[float, float]:
    """Centimetres and degrees between two motions."""
    difference = np.linalg.inv(given) @ found
    cosine = np.clip((np.trace(difference[:3, :3]) - 1) / 2, -1, 1)
    return 100 * float(np.linalg.norm(difference[:3, 3])), float(np.degrees(np.arccos(cosine)))


def this_library() -> Registration:
    def register(target_depth: np.ndarray, source_depth: np.ndarray) -> tuple[np.ndarray, Stages]:
        target = jax.block_until_ready(prepare(target_depth, CAMERA))
        begin = time.perf_counter()
        source = jax.block_until_ready(prepare(source_depth, CAMERA))
        prepared = time.perf_counter()
        result = jax.block_until_ready(align(source, target, se3.identity()))
        end = time.perf_counter()
        return np.asarray(se3.matrix(result.T_target_source), np.float64), {
            "prepare": prepared - begin,
            "align": end - prepared,
        }

    return register


def small_gicp(stride: int = 1, voxel: float = 0.04) -> Registration:
    """Every stride-th row and column to its voxel grid; 4 cm leave some 5500 points of a whole image."""
    import small_gicp as peer  # pyright: ignore[reportMissingImports]

    v, u = np.mgrid[:480:stride, :640:stride]
    rays = np.stack([(u - 320.0) / 585.0, (v - 240.0) / 585.0, np.ones_like(u)], -1).reshape(-1, 3)

    def points_of(depth: np.ndarray) -> np.ndarray:
        # The fastest of four ways tried: rays made beforehand, taken by index.
        z = depth[::stride, ::stride].ravel()
        seen = np.flatnonzero(z)
        return rays[seen] * z[seen, None]

    def preprocess(points: np.ndarray):
        return peer.preprocess_points(points, downsampling_resolution=voxel, num_threads=2)

    def register(target_depth: np.ndarray, source_depth: np.ndarray) -> tuple[np.ndarray, Stages]:
        target, tree = preprocess(points_of(target_depth))
        begin = time.perf_counter()
        points = points_of(source_depth)
        converted = time.perf_counter()
        source, _ = preprocess(points)
        prepared = time.perf_counter()
        result = peer.align(
            target, source, tree, registration_type="GICP", max_correspondence_distance=0.1, num_threads=2
        )
        end = time.perf_counter()
        return result.T_target_source, {
            "points": converted - begin,
            "prepare": prepared - converted,
            "align": end - prepared,
        }

    return register


def open3d() -> Registration:
    """Its multi-scale RGB-D odometry on depth alone, point to plane; depth is prepared within it."""
    peer: Any = importlib.import_module("open3d")

    odometry, tensor = peer.t.pipelines.odometry, peer.core.Tensor
    intrinsics = tensor(np.asarray([[585.0, 0, 320.0], [0, 585.0, 240.0], [0, 0, 1]]))
    black = peer.t.geometry.Image(tensor(np.zeros((480, 640, 3), np.float32)))
    scales = [odometry.OdometryConvergenceCriteria(n) for n in (10, 5, 3)]

    def image(depth: np.ndarray):
        return peer.t.geometry.RGBDImage(black, peer.t.geometry.Image(tensor(depth)))

    def register(target_depth: np.ndarray, source_depth: np.ndarray) -> tuple[np.ndarray, Stages]:
        target = image(target_depth)
        begin = time.perf_counter()
        source = image(source_depth)
        prepared = time.perf_counter()
        result = odometry.rgbd_odometry_multi_scale(
            source, target, intrinsics, tensor(np.eye(4)), 1.0, 10.0, scales, odometry.Method.PointToPlane
        )
        end = time.perf_counter()
        return result.transformation.numpy(), {"prepare": prepared - begin, "align": end - prepared}

    return register


def measure(name: str, register: Registration, folder: Path, gaps: Sequence[int], table: Table) -> None:
    register(load(folder, 0)[0], load(folder, 1)[0])
    for gap in gaps:
        errors, stages = [], []
        for start in STARTS:
            (target, T_world_target), (source, T_world_source) = (
                load(folder, i) for i in (start, start + gap)
            )
            found, seconds = register(target, source)
            errors.append(motion_error(found, np.linalg.inv(T_world_target) @ T_world_source))
            stages.append((*(seconds.get(stage, 0.0) for stage in STAGES), sum(seconds.values())))
        median, high = np.median(errors, axis=0), np.percentile(errors, 90, axis=0)
        times = [f"{1000 * t:.1f}" for t in np.median(stages, axis=0)]
        table.add_row(
            name, str(gap), *times, f"{median[0]:.2f} / {high[0]:.2f}", f"{median[1]:.3f} / {high[1]:.3f}"
        )


def main() -> None:
    folder = data_root() / "data" / "7scenes" / "redkitchen"
    table = Table(title="Registration of RedKitchen depth images, 640x480")
    for column in (
        "",
        "frames apart",
        "points ms",
        "prepare ms",
        "align ms",
        "total ms",
        "cm median / p90",
        "° median / p90",
    ):
        table.add_column(column, justify="left" if not column else "right")
    gaps = tuple(map(int, sys.argv[1:])) or GAPS
    measure("sfgs_jax", this_library(), folder, gaps, table)
    peers: tuple[tuple[str, str, Callable[[], Registration]], ...] = (
        ("small_gicp", "small_gicp", small_gicp),
        ("small_gicp", "small_gicp, every 2nd row and column, 5 cm", lambda: small_gicp(2, 0.05)),
        ("open3d", "Open3D", open3d),
    )
    for module, name, peer in peers:
        if importlib.util.find_spec(module):
            measure(name, peer(), folder, gaps, table)
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
