"""Registration of unorganised clouds: time, error and memory by points and resolution, beside small_gicp.

    python -m benchmarks.gicp_points [rings ...].

Registers two scans of a synthetic street with 2 cm of noise, 0.5 m and 1 degree apart, from the identity. The
scans are handed over as PLY files. The sensor has 32, 64 and 128 rings, or the numbers given. The number
after sfgs_jax is `PointsConfig.max_points`. Times are medians of three after warm-up, of the preparation of
one cloud and of one alignment. Compare rows of one run.
"""

import importlib.util
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import trimesh
from rich.console import Console
from rich.table import Table

from benchmarks.gicp import motion_error
from sfgs_jax.geometry import se3
from sfgs_jax.gicp import PointsConfig, align, load_points, prepare_points
from tests.gicp.lidar import street_scan

MOTION = np.asarray(se3.matrix(se3.exp(jnp.asarray([0.5, 0.05, 0.01, 0.003, 0.004, 0.017]))), np.float64)
STEPS = {32: 600, 64: 1300, 128: 2600}  # directions per ring
CAPACITIES = (4096, 16384, 32768)

T = TypeVar("T")


def timed(work: Callable[[], T]) -> tuple[T, float]:
    result, seconds = work(), []
    for _ in range(3):
        begin = time.perf_counter()
        result = work()
        seconds.append(time.perf_counter() - begin)
    return result, 1000 * float(np.median(seconds))


def ours(target: np.ndarray, source: np.ndarray, capacity: int, table: Table) -> None:
    config = PointsConfig(max_points=capacity)
    fixed = prepare_points(target, config=config)
    moving, prepare_ms = timed(lambda: jax.block_until_ready(prepare_points(source, config=config)))
    result, align_ms = timed(lambda: jax.block_until_ready(align(moving, fixed, se3.identity())))
    error = motion_error(np.asarray(se3.matrix(result.T_target_source), np.float64), MOTION)
    voxel, used = 100 * float(moving.levels[0].voxel_size), int(moving.levels[0].valid.sum())
    kilobytes = sum(leaf.nbytes for leaf in jax.tree.leaves(moving)) // 1024
    row = f"sfgs_jax, {capacity}", len(source), f"{voxel:.0f}", used, f"{prepare_ms:.0f}", f"{align_ms:.0f}"
    table.add_row(*map(str, row), f"{error[0]:.2f}", f"{error[1]:.3f}", str(kilobytes))


def small_gicp(target: np.ndarray, source: np.ndarray, voxel: float, table: Table) -> None:
    import small_gicp as peer  # pyright: ignore[reportMissingImports]

    def preprocess(points: np.ndarray):
        return peer.preprocess_points(points, downsampling_resolution=voxel, num_threads=2)

    fixed, tree = preprocess(target)
    (moving, _), prepare_ms = timed(lambda: preprocess(source))
    result, align_ms = timed(
        lambda: peer.align(
            fixed, moving, tree, registration_type="GICP", max_correspondence_distance=1.0, num_threads=2
        )
    )
    error = motion_error(result.T_target_source, MOTION)
    row = (
        "small_gicp",
        len(source),
        f"{100 * voxel:.0f}",
        moving.size(),
        f"{prepare_ms:.0f}",
        f"{align_ms:.0f}",
    )
    table.add_row(*map(str, row), f"{error[0]:.2f}", f"{error[1]:.3f}", "")


def through_a_file(points: np.ndarray, folder: str) -> np.ndarray:
    """The points as they come back from a PLY file."""
    path = Path(folder) / "cloud.ply"
    trimesh.PointCloud(points).export(path)
    return load_points(path)


def main() -> None:
    table = Table(title="Registration of LiDAR-like clouds")
    for column in ("", "points", "voxel cm", "used", "prepare ms", "align ms", "cm", "°", "kB"):
        table.add_column(column, justify="left" if not column else "right")
    for rings in map(int, sys.argv[1:] or STEPS):
        rng = np.random.default_rng(0)
        target, source = (
            street_scan(pose, rng, rings=rings, steps=STEPS[rings]) for pose in (np.eye(4), MOTION)
        )
        with tempfile.TemporaryDirectory() as folder:
            target, source = [through_a_file(cloud, folder) for cloud in (target, source)]
        for capacity in CAPACITIES:
            ours(target, source, capacity, table)
        if importlib.util.find_spec("small_gicp"):
            for voxel in (0.5, 0.25, 0.1):
                small_gicp(target, source, voxel, table)
        table.add_section()
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
