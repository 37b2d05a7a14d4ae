"""The map of a run as a triangle mesh, for `sfgs-jax export --mesh`."""

from pathlib import Path

import numpy as np

from sfgs_jax.arrays import InputError
from sfgs_jax.cli._log import logger
from sfgs_jax.cli._progress import reporting
from sfgs_jax.cli._run_camera import camera_like, run_camera
from sfgs_jax.geometry import read_tum
from sfgs_jax.splatting import Gaussians, RenderConfig, Renderer
from sfgs_jax.splatting.mesh import TsdfVolume, save_mesh, without_small_parts, zero_surface

_MOST_VIEWS = 200
"""Poses of a long trajectory that are drawn, evenly spaced."""

_OPAQUE = 0.5
"""Opacity below which a pixel shows too little of the map for a surface."""

_MEGABYTE = 1_000_000


def export_mesh(
    run: Path,
    gaussians: Gaussians,
    out: Path,
    *,
    recording: str | None,
    voxel: float,
    max_bytes: int,
    least_triangles: int,
) -> None:
    """Draw the map along the run's trajectory, fuse the depth, and write the surface; print its size.

    Args:
        run: folder that a run wrote.
        gaussians: its map.
        out: file to write.
        recording: new place of the recording, which knows the camera; None for that of the run.
        voxel: side of a voxel, metres.
        max_bytes: most memory of the voxels.
        least_triangles: connected parts with fewer triangles are left out.

    Raises:
        InputError: the run has no trajectory, or nothing is opaque along it.
    """
    if not (run / "trajectory.txt").is_file():
        raise InputError(f"A mesh needs the trajectory of a run, and {run} has none: give the run's folder.")
    poses = read_tum(run / "trajectory.txt").poses
    poses = poses[np.unique(np.linspace(0, len(poses) - 1, min(len(poses), _MOST_VIEWS)).astype(int))]
    camera = camera_like(run_camera(run, recording))
    volume = TsdfVolume(voxel, max_bytes=max_bytes)
    render = Renderer(RenderConfig(surface_depth=True))
    with reporting(quiet=False) as report:
        for number, pose in enumerate(poses):
            output = render(gaussians, camera, pose)
            depth, middle = np.asarray(output.surface_depth), np.asarray(output.median_depth)
            # A mean far from the median lies between two surfaces.
            sure = (np.asarray(output.alpha) > _OPAQUE) & (np.abs(depth - middle) < volume.truncation)
            volume.integrate(np.where(sure, depth, np.float32(0)), np.asarray(output.rgb), camera, pose)
            report("fusing, image", number + 1, len(poses))
    mesh = without_small_parts(zero_surface(volume), least_triangles)
    if volume.num_dropped:
        logger.warning(
            "%d of %d bricks of voxels found no room, so the mesh has holes: take a larger --voxel or more "
            "--mesh-memory.",
            volume.num_dropped,
            volume.num_dropped + len(volume.bricks),
        )
    save_mesh(out, mesh)
    print(
        f"{out}: {len(mesh.triangles)} triangles from {len(poses)} images, voxels of {voxel:g} m in "
        f"{volume.num_bytes / _MEGABYTE:.0f} MB, {out.stat().st_size / _MEGABYTE:.1f} MB"
    )
