"""EuRoC's layout with depth: mav0/cam0/, mav0/depth0/, and optionally mav0/state_groundtruth_estimate0/.

Source: Burri et al., The EuRoC micro aerial vehicle datasets, IJRR 2016. Depth beside cam0, and registered
to it, is a common addition of RGB-D exports. Poses are the body's; T_BS takes them to the camera.
"""

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError, excerpt
from sfgs_jax.datasets._association import associate
from sfgs_jax.datasets._options import ReaderOptions
from sfgs_jax.datasets.files import (
    FilePair,
    FileRecording,
    Intrinsics,
    common_view,
    ground_truth_of_trajectory,
    listed_file,
    quaternion_poses,
    read_camera_json,
    read_numbers,
    read_text,
    rigid_poses,
)
from sfgs_jax.geometry import Trajectory

_UNITS_PER_METRE = 1000.0
_DEPTH_FOLDERS = ("depth0", "depth")
_TRUTH_FOLDERS = ("state_groundtruth_estimate0", "mocap0")
_NO_DISTORTION = ("", "none")
_DISTORTION = ("radial-tangential", "radtan", "plumb_bob")


def matches(source: Path) -> bool:
    """True if the folder has mav0/cam0/data.csv, or is mav0 itself."""
    return _root(source) is not None


def read(source: Path, options: ReaderOptions) -> FileRecording:
    """Open a recording in EuRoC's layout. Arguments and errors as of `open_recording`."""
    root = _root(source)
    if root is None:
        raise InputError(f"{source} has no mav0/cam0/data.csv.")
    depth_folder = next(
        (root / name for name in _DEPTH_FOLDERS if (root / name / "data.csv").is_file()), None
    )
    if depth_folder is None:
        raise InputError(
            f"{root} has no depth0/data.csv; add depth registered to cam0, EuRoC's own has none."
        )
    sensor = root / "cam0" / "sensor.yaml"
    intrinsics = read_camera_json(options.camera) if options.camera else _intrinsics(sensor)
    scale = options.depth_scale or _UNITS_PER_METRE
    colour_times, colour = _read_list(root / "cam0")
    depth_times, depth = _read_list(depth_folder)
    matched = associate(colour_times, depth_times, options.association_limit)
    pairs = [FilePair(colour[i], depth[j], colour_times[i].item(), depth_times[j].item()) for i, j in matched]
    left_out = len(colour) - len(matched)
    notes = [f"{left_out} of {len(colour)} images have no depth and are left out."] if left_out else []
    view = common_view(source, pairs, scale, intrinsics)
    ground_truth, truth_notes = _ground_truth(root, sensor, colour_times[matched[:, 0]], options)
    return FileRecording(
        name=root.resolve().parent.name if root.name == "mav0" else root.resolve().name,
        dataset="euroc",
        camera=view.camera,
        pairs=pairs,
        units_per_metre=scale,
        ground_truth=ground_truth,
        notes=(*intrinsics.notes, *notes, *view.notes, *truth_notes),
        register=view.register,
    )


def _root(source: Path) -> Path | None:
    """The folder that holds cam0."""
    folders = (source / "mav0", source)
    return next((folder for folder in folders if (folder / "cam0" / "data.csv").is_file()), None)


def _read_list(folder: Path) -> tuple[Float[np.ndarray, " n"], list[Path]]:
    """Time stamps in seconds, sorted, and files of a sensor's data.csv."""
    path = folder / "data.csv"
    rows = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        words = [word.strip() for word in line.split("#")[0].split(",")]
        if words == [""]:
            continue
        if len(words) != 2 or not re.fullmatch(r"\d{1,19}", words[0]):
            raise InputError(f"{path}, line {number}: expected 'nanoseconds,file', found {excerpt(line)}.")
        rows.append((int(words[0]) / 1e9, listed_file(folder / "data", words[1], path)))
    rows.sort(key=lambda row: row[0])
    return np.asarray([row[0] for row in rows], np.float64), [row[1] for row in rows]


def _intrinsics(path: Path) -> Intrinsics:
    text = _sensor_text(path)
    focal, size = _list(text, "intrinsics"), _list(text, "resolution")
    if len(focal) != 4 or len(size) != 2 or not all(number.is_integer() for number in size):
        raise InputError(f"{path} should hold intrinsics: [fu, fv, cu, cv] and resolution: [width, height].")
    distortion, model = _list(text, "distortion_coefficients"), _word(text, "distortion_model")
    if _word(text, "camera_model") not in ("", "pinhole") or (
        any(distortion) and model not in (*_NO_DISTORTION, *_DISTORTION)
    ):
        raise InputError(f"{path}: only pinhole cameras with radial-tangential distortion can be read.")
    width, height = (int(number) for number in size)
    return Intrinsics(
        *focal, width=width, height=height, distortion=tuple(distortion) if any(distortion) else ()
    )


def _ground_truth(
    root: Path, sensor: Path, timestamps: Float[np.ndarray, " n"], options: ReaderOptions
) -> tuple[Trajectory | None, list[str]]:
    """Poses of the camera from lines of nanoseconds, position, and quaternion with its real part first."""
    paths = (root / name / "data.csv" for name in _TRUTH_FOLDERS)
    path = next((path for path in paths if path.is_file()), None)
    if path is None:
        return None, []
    rows = read_numbers(path)
    if any(len(row) < 8 for row in rows):
        raise InputError(f"{path} should have lines of a time stamp, a position and a quaternion.")
    table = np.asarray([row[:8] for row in rows], np.float64).reshape(-1, 8)
    poses = quaternion_poses(table[:, 1:4], table[:, [5, 6, 7, 4]]) @ _T_body_camera(sensor)
    order = np.argsort(table[:, 0], kind="stable")
    order = order[np.isfinite(poses[order]).all(axis=(1, 2)) & np.isfinite(table[order, 0])]
    trajectory = Trajectory(table[order, 0] / 1e9, poses[order])
    broken = len(table) - len(order)
    return ground_truth_of_trajectory(trajectory, broken, path, timestamps, options.association_limit)


def _T_body_camera(path: Path) -> Float[np.ndarray, "4 4"]:
    """The camera's pose in the body, the identity if the file does not give it."""
    block = re.search(r"^T_BS:.*?^\s*data:\s*(\[[^\]]*\])", _sensor_text(path), re.DOTALL | re.MULTILINE)
    if block is None:
        return np.eye(4)
    numbers = _list(f"data: {block[1]}", "data")
    pose = rigid_poses(np.reshape(numbers, (1, 4, 4)))[0] if len(numbers) == 16 else np.full((4, 4), np.nan)
    if not np.isfinite(pose).all():
        raise InputError(f"{path}: T_BS should be the 16 numbers of a rigid motion.")
    return pose


def _sensor_text(path: Path) -> str:
    """A sensor.yaml without its comments; its lists are all in brackets."""
    return re.sub(r"#.*", "", read_text(path))


def _list(text: str, key: str) -> list[float]:
    """The numbers in the brackets behind a key; none if they aren't there."""
    found = re.search(rf"^\s*{key}:\s*\[([^\]]*)\]", text, re.MULTILINE)
    try:
        return [float(word) for word in found[1].replace(",", " ").split()] if found else []
    except ValueError:
        return []


def _word(text: str, key: str) -> str:
    found = re.search(rf"^\s*{key}:[ \t]*(\S*)", text, re.MULTILINE)
    return found[1].strip("'\"") if found else ""
