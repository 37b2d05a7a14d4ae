"""`sfgs-jax export`: the map of a run, or its poses and images, in the format of another program."""

import dataclasses
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import jax.numpy as jnp
import numpy as np
import tyro
from scipy.special import logit

from sfgs_jax.arrays import InputError, check_counts, check_positive, check_range, write_atomically
from sfgs_jax.cli._configuration import read_config
from sfgs_jax.cli._mesh_export import export_mesh
from sfgs_jax.datasets import open_recording
from sfgs_jax.geometry import format_kitti, format_tum, read_tum
from sfgs_jax.splatting import (
    Gaussians,
    load_map,
    load_ply,
    map_file,
    save_gltf,
    save_ply,
    save_points,
    save_splat,
    save_spz,
)

Format = Literal["ply", "splat", "spz", "glb"]
"""Formats by the suffix of their files."""

Poses = Literal["tum", "kitti", "nerfstudio", "colmap", "rerun"]
"""Formats of the poses of a run."""

_WRITERS: Mapping[Format, Callable[[Path, Gaussians], None]] = {
    "ply": save_ply,
    "splat": save_splat,
    "spz": save_spz,
    "glb": save_gltf,
}


@dataclasses.dataclass(frozen=True)
class ExportArguments:
    """Write a map, or with --poses a run, for other programs. The suffix of OUT names a map's format."""

    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SOURCE")]
    """Folder that `sfgs-jax run` wrote, or a file of Gaussians: .ply, .splat, .spz or .glb."""
    out: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="OUT")]
    """File to write; for the poses of nerfstudio and COLMAP a new folder."""
    format: Format | None = None
    """Format of the file. None takes the suffix of OUT."""
    points: bool = False
    """Write the centres of the Gaussians as a coloured point cloud, for programs that know no splats."""
    mesh: bool = False
    """Write the surface as a coloured triangle mesh, .glb or .ply, fused from depth along the run's path."""
    voxel: float = 0.02
    """Side of a voxel of the mesh, metres."""
    mesh_memory: int = 1000
    """Most memory of the mesh's voxels, MB."""
    mesh_part: int = 100
    """Connected parts of the mesh with fewer triangles are left out."""
    min_opacity: float = 0.0
    """Gaussians with a lower opacity are left out, from 0 to 1."""
    spz_version: Literal[3, 4] | None = None
    """Version of an SPZ file. None writes version 3; version 4 needs zstd."""
    poses: Poses | None = None
    """Write the poses of a run instead of its map alone. TUM and KITTI are text files, rerun is an .rrd file.
    The folders of nerfstudio (also for instant-ngp) and COLMAP hold images and the map's points too."""
    recording: str | None = None
    """New place of the recording, if it has moved since the run. The options --poses and --mesh read its
    camera, and --poses its images."""
    overwrite: bool = False
    """Replace OUT if it exists."""

    def __post_init__(self) -> None:
        """Refuse values that have no meaning."""
        check_range(self, 0, 1, "min_opacity")
        check_positive(self, "voxel")
        check_counts(self, 1, "mesh_memory", "mesh_part")


def export_command(arguments: list[str]) -> int:
    """Run the command; see ExportArguments."""
    options = tyro.cli(ExportArguments, prog="sfgs-jax export", args=arguments)
    if options.poses is not None:
        return _export_poses(options, options.poses)
    source = map_file(options.source)
    write = _writer(options)
    _require_place(options.out, source, overwrite=options.overwrite)
    gaussians = _at_least(load_map(source), options.min_opacity)
    count = int(np.sum(gaussians.valid))
    if not count:
        at_all = f" with an opacity of {options.min_opacity:g} or more" if options.min_opacity else ""
        raise InputError(f"{source} holds no Gaussian{at_all}: there is nothing to export.")
    if options.mesh:
        export_mesh(
            options.source,
            gaussians,
            options.out,
            recording=options.recording,
            voxel=options.voxel,
            max_bytes=1_000_000 * options.mesh_memory,
            least_triangles=options.mesh_part,
        )
        return 0
    write(options.out, gaussians)
    size = options.out.stat().st_size
    amount = f"{size / 1e6:.1f} MB" if size >= 1e6 else f"{size / 1e3:.1f} kB"
    print(f"{options.out}: {count} Gaussians, {amount}")
    return 0


def _export_poses(options: ExportArguments, poses: Poses) -> int:
    """Write the poses of a run, with its images where the format has them."""
    folder, out = options.source, options.out
    if options.points or options.format or options.spz_version or options.min_opacity or options.mesh:
        raise InputError(
            "--points, --mesh, --format, --spz-version and --min-opacity are for maps, not for --poses."
        )
    missing = next((name for name in ("trajectory.txt", "map.ply") if not (folder / name).is_file()), None)
    if missing is not None:
        raise InputError(f"{folder} has no {missing}: give the folder that `sfgs-jax run` wrote.")
    is_folder = poses in ("nerfstudio", "colmap")
    if not is_folder:
        _require_place(out, folder / "trajectory.txt", overwrite=options.overwrite)
    if poses in ("tum", "kitti"):
        trajectory = read_tum(folder / "trajectory.txt")
        write_atomically(out, format_tum(trajectory) if poses == "tum" else format_kitti(trajectory))
        print(f"{out}: {len(trajectory)} poses")
        return 0
    # Imported here: plotting comes with it, which the formats of maps do without.
    from sfgs_jax.evaluation import posed_frames, write_colmap, write_nerfstudio, write_rerun

    write = {"nerfstudio": write_nerfstudio, "colmap": write_colmap, "rerun": write_rerun}[poses]
    config = read_config(folder / "config.json")
    place = options.recording or config.source
    recording = open_recording(place, dataset=config.dataset, options=config.reader)
    count = write(out, recording, posed_frames(folder, recording), load_ply(folder / "map.ply"))
    print(f"{out}: {count} frames with their poses")
    return 0


def _writer(options: ExportArguments) -> Callable[[Path, Gaussians], None]:
    """The function that writes the format.

    Raises:
        InputError: the suffix names no format, or the format holds no point cloud.
    """
    name = options.format or options.out.suffix.lower().removeprefix(".")
    if options.mesh and (name not in ("ply", "glb") or options.points):
        kind = "a point cloud" if options.points else f".{name}"
        raise InputError(f"A mesh is written as .ply or .glb, not as {kind}.")
    write = next((write for known, write in _WRITERS.items() if known == name), None)
    if write is None:
        suffixes = ", ".join(f".{known}" for known in _WRITERS)
        raise InputError(f"The suffix of {options.out} names no format: use {suffixes}, or pass --format.")
    if options.spz_version is not None:
        if name != "spz":
            raise InputError(f"--spz-version is for SPZ files, not for .{name}.")
        return partial(save_spz, version=options.spz_version)
    if options.points:
        if name != "ply":
            raise InputError(f"A point cloud is written as .ply, not as .{name}.")
        return save_points
    return write


def _require_place(out: Path, source: Path, *, overwrite: bool) -> None:
    """Refuse an output that can't be written, that exists, or that is the map itself."""
    if not out.parent.is_dir():
        raise InputError(f"There is no folder {out.parent} for {out.name}; make it first.")
    if out.is_dir():
        raise InputError(f"{out} is a folder; give the name of a file.")
    if not out.exists():
        return
    if out.samefile(source):
        raise InputError(f"{out} is the map itself; give another name.")
    if not overwrite:
        raise InputError(f"{out} exists: give another name, or pass --overwrite to replace it.")


def _at_least(gaussians: Gaussians, opacity: float) -> Gaussians:
    """The Gaussians with at least that opacity; the others are no longer valid."""
    opaque = np.asarray(gaussians.opacity_logits) >= logit(opacity)
    return dataclasses.replace(gaussians, valid=jnp.asarray(np.asarray(gaussians.valid) & opaque))
