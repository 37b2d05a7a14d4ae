"""`sfgs-jax render`: pictures of a map, or a video, along a path of the camera."""

import dataclasses
import math
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import jax.numpy as jnp
import numpy as np
import tyro
from jaxtyping import Float, Shaped
from scipy.special import expit

from sfgs_jax.arrays import (
    InputError,
    check_counts,
    check_positive,
    check_range,
    enable_cache,
    write_atomically,
)
from sfgs_jax.cli._log import logger
from sfgs_jax.cli._picture_files import (
    ANIMATION_SUFFIXES,
    VIDEO_SUFFIX,
    AnimationFile,
    PngFolder,
    VideoFile,
    false_colours,
    normal_colours,
    rgb_levels,
)
from sfgs_jax.cli._progress import reporting
from sfgs_jax.cli._run_camera import camera_like, run_camera
from sfgs_jax.datasets.files import depth_units
from sfgs_jax.geometry import Camera, Trajectory, format_tum, orbit, read_tum, smoothed
from sfgs_jax.splatting import (
    BACKGROUND_FILE,
    Gaussians,
    RenderConfig,
    Renderer,
    camera_normals,
    load_map,
    read_background,
    unit_normals,
    with_background,
)

_FRAMES_PER_SECOND = 30.0

_MILLIMETRES = 1000.0

_OPAQUE = 0.5
"""Opacity below which a pixel shows too little of the map for a depth or a normal."""


@dataclasses.dataclass(frozen=True)
class RenderArguments:
    """Draw a map along a path of the camera, without a screen: numbered PNG images, a video or a GIF."""

    path: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RUN|FILE")]
    """Folder that `sfgs-jax run` wrote, or a file of Gaussians: .ply, .splat, .spz or .glb."""
    out: Path
    """Folder for the images, an .mp4 file for a video, or a .gif or .webp file for an animated image."""
    trajectory: Path | None = None
    """File of poses in TUM format, in the axes of the map. None takes the run's own trajectory."""
    orbit: int | None = None
    """Number of images of a turntable around the middle of the map, in place of a trajectory."""
    radius: float | None = None
    """Distance of the turntable's cameras from the middle, metres. None shows most of the map."""
    elevation: float = 20.0
    """Angle by which the turntable's cameras are above the middle, degrees."""
    every: int = 1
    """Draw every n-th pose of the trajectory."""
    smooth: float = 0.0
    """Standard deviation of the Gaussian filter that steadies the trajectory, in poses. 0 leaves it out."""
    width: int | None = None
    """Width of the images, pixels. None takes that of the recording, or 640."""
    height: int | None = None
    """Height of the images, pixels. None takes that of the recording, or 480."""
    recording: str | None = None
    """New place of the recording, which knows the camera, if it has moved since the run."""
    fov: float | None = None
    """Horizontal field of view, degrees. None takes that of the recording, or 60."""
    background: tuple[float, float, float] | None = None
    """Red, green and blue behind the map, each from 0 to 1. None takes the run's own
    along a trajectory, and black around a turntable."""
    near: float = 0.1
    """Least depth of the Gaussians drawn, metres. Greater values cut a room open for a view from outside."""
    depth: bool = False
    """Write depth too: PNG images of 16 bits in millimetres, or a video in false colours."""
    normals: bool = False
    """Write normals too, as colours: x to the right, y up and z towards the camera."""
    fps: float = _FRAMES_PER_SECOND
    """Images of a video or an animated image per second."""
    overwrite: bool = False
    """Replace images or videos that exist."""
    quiet: bool = False
    """Print nothing but errors."""

    def __post_init__(self) -> None:
        """Refuse values that have no meaning."""
        for name in ("orbit", "width", "height"):
            if getattr(self, name) is not None:
                check_counts(self, 1, name)
        for name in ("radius", "near", "fps"):
            if getattr(self, name) is not None:
                check_positive(self, name)
        check_counts(self, 1, "every")
        check_range(self, 0, math.inf, "smooth")
        check_range(self, -89, 89, "elevation")
        if self.fov is not None:
            check_range(self, 1, 170, "fov")
        if self.background is not None and not all(0 <= level <= 1 for level in self.background):
            raise InputError(
                f"The setting background must be three numbers from 0 to 1, not {self.background}."
            )
        if self.orbit is not None and self.trajectory is not None:
            raise InputError("Give either --orbit or --trajectory, not both.")


def render_command(arguments: list[str]) -> int:
    """Run the command; see RenderArguments."""
    options = tyro.cli(RenderArguments, prog="sfgs-jax render", args=arguments)
    gaussians = load_map(options.path)
    if not np.any(gaussians.valid):
        raise InputError(f"{options.path} holds no Gaussian: there is nothing to draw.")
    camera = camera_like(
        run_camera(options.path, options.recording),
        width=options.width,
        height=options.height,
        field_of_view=options.fov,
    )
    trajectory = _path_of_camera(options, gaussians, camera)
    _require_place(options)
    try:
        enable_cache()
    except InputError as error:
        logger.warning("%s", error)
    for kind in _kinds(options):
        for old in _place(options.out, kind).glob("[0-9]*.png"):
            old.unlink()
    with ExitStack() as stack, reporting(quiet=options.quiet) as report:
        files = {kind: stack.enter_context(_file(options, kind)) for kind in _kinds(options)}
        for index, pictures in enumerate(_draw(options, gaussians, camera, trajectory)):
            for kind, picture in pictures.items():
                files[kind].write(picture)
            report("drawing, image", index + 1, len(trajectory))
    if not _is_video(options.out):
        write_atomically(options.out / "trajectory.txt", format_tum(trajectory))
    if not options.quiet:
        print(f"{options.out}: {len(trajectory)} images of {camera.width}x{camera.height}")
    return 0


def _is_video(out: Path) -> bool:
    """True if the pictures move in one file."""
    return out.suffix.lower() in (VIDEO_SUFFIX, *ANIMATION_SUFFIXES)


def _kinds(options: RenderArguments) -> list[str]:
    asked = {"rgb": True, "depth": options.depth, "normals": options.normals}
    return [kind for kind, wanted in asked.items() if wanted]


def _place(out: Path, kind: str) -> Path:
    """Folder or file of a kind of picture."""
    if not _is_video(out):
        return out / kind
    return out if kind == "rgb" else out.with_stem(f"{out.stem}_{kind}")


def _file(options: RenderArguments, kind: str) -> PngFolder | VideoFile | AnimationFile:
    place = _place(options.out, kind)
    if place.suffix.lower() in ANIMATION_SUFFIXES:
        return AnimationFile(place, options.fps)
    return VideoFile(place, options.fps) if _is_video(options.out) else PngFolder(place)


def _require_place(options: RenderArguments) -> None:
    """Refuse an output that can't be written or that exists."""
    out = options.out
    if not out.parent.is_dir():
        raise InputError(f"There is no folder {out.parent} for {out.name}; make it first.")
    if not _is_video(out) and out.suffix and not out.is_dir():
        known = ", ".join((VIDEO_SUFFIX, *ANIMATION_SUFFIXES))
        raise InputError(f"A video is written as {known}, not as {out.suffix}; images need a folder.")
    if _is_video(out) and out.is_dir():
        raise InputError(f"{out} is a folder; give the name of a file.")
    for kind in _kinds(options):
        place = _place(out, kind)
        if place.is_file() and not _is_video(out):
            raise InputError(f"{place} is a file; images need a folder.")
        taken = any(place.iterdir()) if place.is_dir() else place.exists()
        if taken and not options.overwrite:
            raise InputError(f"{place} exists: give another name, or pass --overwrite to replace it.")


def _path_of_camera(options: RenderArguments, gaussians: Gaussians, camera: Camera) -> Trajectory:
    """The poses to draw."""
    own = options.path / "trajectory.txt"
    if options.orbit is not None:
        return _turntable(options, gaussians, camera, read_tum(own) if own.is_file() else None)
    if options.trajectory is None and not own.is_file():
        raise InputError(f"{options.path} has no trajectory: give --trajectory FILE or --orbit NUMBER.")
    source = options.trajectory or own
    trajectory = smoothed(read_tum(source), options.smooth)[:: options.every]
    if not len(trajectory):
        raise InputError(f"{source} holds no pose: there is nothing to draw.")
    return trajectory


def _turntable(
    options: RenderArguments, gaussians: Gaussians, camera: Camera, trajectory: Trajectory | None
) -> Trajectory:
    """Poses around the middle of the opaque Gaussians, upright as the run's cameras were on average."""
    opaque = np.asarray(gaussians.valid) & (expit(np.asarray(gaussians.opacity_logits)) > 0.5)
    means = np.asarray(gaussians.means, np.float64)[opaque if np.any(opaque) else np.asarray(gaussians.valid)]
    target = np.median(means, axis=0)
    up = np.asarray([0.0, -1, 0])
    if trajectory is not None and len(trajectory):
        mean = -trajectory.poses[:, :3, 1].mean(axis=0)
        # Cameras that look in all directions of a roll have no side that is upwards.
        up = mean if np.linalg.norm(mean) > 0.1 else up
    radius = options.radius
    if radius is None:
        extent = float(np.percentile(np.linalg.norm(means - target, axis=1), 80))
        half = min(camera.width / 2 / float(camera.fx), camera.height / 2 / float(camera.fy))
        radius = max(extent, 1e-3) / math.sin(math.atan(half))
    poses = orbit(
        target, up, radius=radius, elevation=math.radians(options.elevation), num_poses=options.orbit or 1
    )
    return Trajectory(np.arange(len(poses)) / options.fps, poses)


def _draw(
    options: RenderArguments, gaussians: Gaussians, camera: Camera, trajectory: Trajectory
) -> Iterator[dict[str, Shaped[np.ndarray, "h w *c"]]]:
    """Pictures by their kinds, pose after pose."""
    render = Renderer(RenderConfig(near=options.near, surface_depth=options.depth))
    colour = None if options.background is None else jnp.asarray(options.background, jnp.float32)
    own, behind = options.path / BACKGROUND_FILE, None
    if colour is None and options.orbit is None and own.is_file():
        behind = jnp.asarray(read_background(own), jnp.float32)
    far: float | None = None
    for pose in trajectory.poses:
        features = camera_normals(gaussians, pose) if options.normals else None
        output = render(gaussians, camera, pose, colour, features=features)
        if behind is not None:
            output = with_background(output, behind, camera, jnp.asarray(pose, jnp.float32))
        pictures: dict[str, Shaped[np.ndarray, "h w *c"]] = {"rgb": rgb_levels(np.asarray(output.rgb))}
        opaque = np.asarray(output.alpha) > _OPAQUE
        if output.surface_depth is not None:
            depth = np.where(opaque, np.asarray(output.surface_depth), np.float32(0))
            far = far or _farthest(depth)
            video = _is_video(options.out)
            pictures["depth"] = false_colours(depth, far) if video else depth_units(depth, _MILLIMETRES)
        if output.features is not None:
            normals = np.where(opaque[..., None], np.asarray(unit_normals(output.features)), 0)
            pictures["normals"] = normal_colours(normals)
        yield pictures


def _farthest(depth: Float[np.ndarray, "h w"]) -> float:
    """Depth of the last of the false colours, by the first image that has depth."""
    return 1.2 * float(np.percentile(depth[depth > 0], 99)) if np.any(depth > 0) else 0.0
