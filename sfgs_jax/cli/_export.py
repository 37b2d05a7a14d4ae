"""`sfgs-jax export`: a map in the format of another program."""

import dataclasses
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import jax.numpy as jnp
import numpy as np
import tyro
from scipy.special import logit

from sfgs_jax.arrays import InputError, check_range
from sfgs_jax.splatting import (
    Gaussians,
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

_WRITERS: Mapping[Format, Callable[[Path, Gaussians], None]] = {
    "ply": save_ply,
    "splat": save_splat,
    "spz": save_spz,
    "glb": save_gltf,
}


@dataclasses.dataclass(frozen=True)
class ExportArguments:
    """Write a map for other programs. The suffix of OUT names the format."""

    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SOURCE")]
    """Folder that `sfgs-jax run` wrote, or a .ply file in the layout of 3DGS."""
    out: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="OUT")]
    """File to write."""
    format: Format | None = None
    """Format of the file. None takes the suffix of OUT."""
    points: bool = False
    """Write the centres of the Gaussians as a coloured point cloud, for programs that know no splats."""
    min_opacity: float = 0.0
    """Gaussians with a lower opacity are left out, from 0 to 1."""
    spz_version: Literal[3, 4] | None = None
    """Version of an SPZ file. None writes version 3; version 4 needs zstd."""
    overwrite: bool = False
    """Replace OUT if it exists."""

    def __post_init__(self) -> None:
        """Refuse values that have no meaning."""
        check_range(self, 0, 1, "min_opacity")


def export_command(arguments: list[str]) -> int:
    """Run the command; see ExportArguments."""
    options = tyro.cli(ExportArguments, prog="sfgs-jax export", args=arguments)
    source = map_file(options.source)
    write = _writer(options)
    _require_place(options.out, source, overwrite=options.overwrite)
    gaussians = _at_least(load_ply(source), options.min_opacity)
    count = int(np.sum(gaussians.valid))
    if not count:
        at_all = f" with an opacity of {options.min_opacity:g} or more" if options.min_opacity else ""
        raise InputError(f"{source} holds no Gaussian{at_all}: there is nothing to export.")
    write(options.out, gaussians)
    size = options.out.stat().st_size
    amount = f"{size / 1e6:.1f} MB" if size >= 1e6 else f"{size / 1e3:.1f} kB"
    print(f"{options.out}: {count} Gaussians, {amount}")
    return 0


def _writer(options: ExportArguments) -> Callable[[Path, Gaussians], None]:
    """The function that writes the format.

    Raises:
        InputError: the suffix names no format, or the format holds no point cloud.
    """
    name = options.format or options.out.suffix.lower().removeprefix(".")
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
