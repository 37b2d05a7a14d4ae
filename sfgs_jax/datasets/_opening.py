"""From a path to a recording."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from sfgs_jax.arrays import InputError, checked_but, described, excerpt
from sfgs_jax.datasets._options import ReaderOptions
from sfgs_jax.datasets._recording import Recording
from sfgs_jax.datasets._selection import select
from sfgs_jax.datasets.files import FileRecording
from sfgs_jax.datasets.layouts import (
    colmap,
    euroc,
    folder,
    icl_nuim,
    nerfstudio,
    open3d,
    record3d,
    replica,
    rosbag,
    scannet,
    scannetpp,
    seven_scenes,
    stray,
    tum,
    video,
)
from sfgs_jax.datasets.synthetic import SyntheticRecording


@dataclass(frozen=True)
class _Layout:
    """One arrangement of a recording on disk.

    Attributes:
        matches: tells whether a folder, or a file, has this layout.
        read: opens it.
        marks: the files it is recognised by, for messages.
    """

    matches: Callable[[Path], bool]
    read: Callable[[Path, ReaderOptions], FileRecording]
    marks: str


# In the order in which they are tried. ScanNet comes after Open3D, which has color/ and depth/ as well. The
# plain folder comes last, since others have rgb/ and depth/.
_FILE_LAYOUTS = {
    "tum": _Layout(tum.matches, tum.read, "rgb.txt and depth.txt"),
    "7scenes": _Layout(seven_scenes.matches, seven_scenes.read, "frame-000000.color.png"),
    "replica": _Layout(replica.matches, replica.read, "results/frame000000.jpg"),
    "icl_nuim": _Layout(icl_nuim.matches, icl_nuim.read, "rgb/ and a *.gt.freiburg file"),
    "open3d": _Layout(open3d.matches, open3d.read, "color/, depth/ and intrinsic.json"),
    "scannet": _Layout(scannet.matches, scannet.read, "color/ and depth/"),
    "stray": _Layout(stray.matches, stray.read, "odometry.csv and depth/"),
    "record3d": _Layout(record3d.matches, record3d.read, "an .r3d archive's metadata and rgbd/"),
    "nerfstudio": _Layout(nerfstudio.matches, nerfstudio.read, "transforms.json"),
    "colmap": _Layout(colmap.matches, colmap.read, "images/ and sparse/0/"),
    "euroc": _Layout(euroc.matches, euroc.read, "mav0/cam0/data.csv"),
    "scannetpp": _Layout(scannetpp.matches, scannetpp.read, "pose_intrinsic_imu.json"),
    "rosbag": _Layout(rosbag.matches, rosbag.read, "a bag's metadata.yaml"),
    "video": _Layout(video.matches, video.read, "a video, depth/ and camera.json"),
    "folder": _Layout(folder.matches, folder.read, "rgb/, depth/ and camera.json"),
}

_SYNTHETIC = "synthetic"

LAYOUTS = (*_FILE_LAYOUTS, _SYNTHETIC)
"""Names of the layouts, the possible values of `dataset`."""


@checked_but("source")
def open_recording(
    source: str | Path, *, dataset: str | None = None, options: ReaderOptions | None = None
) -> Recording:
    """Open a recording, recognising its layout; docs/datasets.md describes the layouts.

    Args:
        source: a folder, or an .r3d or bag file; or "synthetic" or
            "synthetic:frames=60,width=160,height=120,seed=1,noise=1" for the built-in synthetic room; or
            "synthetic:place=ring,frames=1000" for another place, and with "kinect=1" a Kinect's faults.
        dataset: one of `LAYOUTS`; None recognises the layout.
        options: units, intrinsics and choice of frames; None means the defaults.

    Raises:
        InputError: the path is missing or no folder, the layout unknown or other than `dataset`, there are
            no images, intrinsics are missing, colour and depth differ in size, or a file can't be understood.
    """
    if not isinstance(source, Path | str):
        raise InputError(
            f"The source of a recording is the path of a folder or file, not {described(source)}."
        )
    options = options or ReaderOptions()
    if dataset is not None and dataset not in LAYOUTS:
        raise InputError(f"There is no layout {dataset!r}; choose from {', '.join(LAYOUTS)}.")
    if options.camera is not None and not options.camera.is_file():
        raise InputError(f"The given camera file {options.camera} does not exist.")
    text = str(source)
    if text == _SYNTHETIC or text.startswith(_SYNTHETIC + ":") or dataset == _SYNTHETIC:
        return select(SyntheticRecording.parse(text), options)
    try:
        path = Path(source).expanduser()
        exists = path.exists()
    except (OSError, ValueError, RuntimeError) as error:  # no name of a file, or of a user
        raise InputError(f"There is no {excerpt(text)}: {excerpt(error)}.") from error
    if not exists:
        raise InputError(f"There is no {path}.")
    if path.is_file() and not any(layout.matches(path) for layout in _FILE_LAYOUTS.values()):
        raise InputError(f"{path} is a file; give the folder of a recording (its images unpacked).")
    layout = _FILE_LAYOUTS[dataset or _recognise(path)]
    if not layout.matches(path):
        raise InputError(f"{path} is no {dataset} recording: it has no {layout.marks}.{_hint(path)}")
    return select(layout.read(path, options), options)


def _recognise(path: Path) -> str:
    for name, layout in _FILE_LAYOUTS.items():
        if layout.matches(path):
            return name
    looked = "; ".join(f"{layout.marks} ({name})" for name, layout in _FILE_LAYOUTS.items())
    raise InputError(f"The layout of {path} is unknown: it has none of {looked}.{_hint(path)}")


def _hint(path: Path) -> str:
    """Recordings inside `path`, since giving the folder above is the usual mistake."""
    children = sorted(path.iterdir()) if path.is_dir() else []
    inside = [
        child.name for child in children if any(layout.matches(child) for layout in _FILE_LAYOUTS.values())
    ]
    if not inside:
        return ""
    more = ", ..." if len(inside) > 5 else ""
    return f" Did you mean one of the recordings inside it: {', '.join(inside[:5])}{more}?"
