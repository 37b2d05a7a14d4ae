"""COLMAP reconstructions with depth: images/, a sparse model, and a depth map for each image.

Depth is a sensor's, in a folder of its own, or COLMAP's own from stereo/depth_maps/. The second has the
reconstruction's unknown scale.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import FrameError, InputError, file_bytes
from sfgs_jax.datasets._options import ReaderOptions
from sfgs_jax.datasets.files import (
    COLOUR_SUFFIXES,
    DEPTH_SUFFIXES,
    FilePair,
    FileRecording,
    common_view,
    depth_of_array,
    ground_truth_by_frame,
    has_colmap_model,
    natural_key,
    one_camera,
    read_camera_json,
    read_colmap_model,
    times_of_names,
)

_FRAMES_PER_SECOND = 30.0
_MODEL_FOLDERS = ("sparse/0", "sparse", "colmap/sparse/0", "")
_DEPTH_FOLDERS = ("depth", "depths", "depth_maps")
_OWN_DEPTH = Path("stereo/depth_maps")
# A header is three numbers with an ampersand behind each.
_LONGEST_HEADER = 64


def matches(source: Path) -> bool:
    """True if the folder has images/ and a sparse model."""
    return (source / "images").is_dir() and _model_folder(source) is not None


def read(source: Path, options: ReaderOptions) -> FileRecording:
    """Open a COLMAP reconstruction. Arguments and errors as of `open_recording`."""
    folder = _model_folder(source)
    if folder is None:
        raise InputError(f"{source} has no sparse model of COLMAP.")
    model = read_colmap_model(folder)
    names = _image_names(source / "images")
    found = {name: image for name in names if (image := _depth_image(source, name)) is not None}
    if not found:
        raise InputError(
            f"No image of {source / 'images'} has a depth map: put it under the image's name into depth/, or "
            "run COLMAP's patch_match_stereo."
        )
    left_out = len(names) - len(found)
    notes = [f"{left_out} of {len(names)} images have no depth map and are left out."] if left_out else []
    if any(isinstance(image, ColmapDepth) for image in found.values()):
        notes.append("COLMAP's own depth is in units of its reconstruction, which need not be metres.")
    else:
        notes.append("COLMAP's poses have a scale of their own: errors are in metres only if that was set.")
    colour = [source / "images" / name for name in found]
    timestamps = times_of_names(colour, _FRAMES_PER_SECOND)
    pairs = [FilePair(*row) for row in zip(colour, found.values(), timestamps.tolist(), strict=True)]
    known = [model.images.get(name) for name in found]
    if options.camera is not None:
        intrinsics = read_camera_json(options.camera)
    else:
        used = [model.cameras.get(image[0]) for image in known if image is not None]
        cameras = [camera for camera in used if camera is not None]
        if not cameras:
            raise InputError(f"The model in {folder} has none of the images that have a depth map.")
        intrinsics = one_camera(cameras, source)
    view = common_view(source, pairs, options.depth_scale, intrinsics)
    poses = [None if image is None else image[1] for image in known]
    ground_truth, truth_notes = ground_truth_by_frame(poses, timestamps)
    return FileRecording(
        name=source.resolve().name,
        dataset="colmap",
        camera=view.camera,
        pairs=pairs,
        units_per_metre=options.depth_scale,
        ground_truth=ground_truth,
        notes=(*notes, *intrinsics.notes, *view.notes, *truth_notes),
        register=view.register,
    )


@dataclass(frozen=True)
class ColmapDepth:
    """A depth map in COLMAP's own format, a `DepthImage`: `width&height&channels&`, then float32 by rows.

    Attributes:
        path: the file.
    """

    path: Path

    def metres(self, units_per_metre: float | None) -> Float[np.ndarray, "h w"]:
        """Depth in metres, 0 where missing. Raises FrameError if the file is no depth map."""
        try:
            data = file_bytes(self.path)
            header = data[:_LONGEST_HEADER].split(b"&")
            width, height, channels = (int(word) for word in header[:3])
        except OSError as error:
            raise FrameError(f"{self.path} cannot be read: {error.strerror or error}.") from error
        except ValueError as error:
            raise FrameError(f"{self.path} is no depth map of COLMAP.") from error
        start = sum(len(word) + 1 for word in header[:3])
        if channels != 1 or min(width, height) < 1 or len(data) - start != 4 * width * height:
            raise FrameError(f"{self.path} is damaged: {len(data)} bytes for {width}x{height}x{channels}.")
        image = np.frombuffer(data, "<f4", offset=start).reshape(height, width)
        return depth_of_array(image, units_per_metre, str(self.path))

    def __str__(self) -> str:
        return str(self.path)


def _model_folder(source: Path) -> Path | None:
    folders = (source / name for name in _MODEL_FOLDERS)
    return next((folder for folder in folders if has_colmap_model(folder)), None)


def _image_names(folder: Path) -> list[str]:
    """Names of the images as the model has them: relative to the folder, in natural order."""
    paths = (path for path in folder.rglob("*") if path.suffix.lower() in COLOUR_SUFFIXES)
    return sorted((path.relative_to(folder).as_posix() for path in paths if path.is_file()), key=natural_key)


def _depth_image(source: Path, name: str) -> Path | ColmapDepth | None:
    """Depth of an image: a file of its name with another ending, or COLMAP's own; None without."""
    for folder in _DEPTH_FOLDERS:
        for stem in (str(Path(name).with_suffix("")), name):
            for suffix in DEPTH_SUFFIXES:
                path = source / folder / f"{stem}{suffix}"
                if path.is_file():
                    return path
    for kind in ("geometric", "photometric"):
        path = source / _OWN_DEPTH / f"{name}.{kind}.bin"
        if path.is_file():
            return ColmapDepth(path)
    return None
