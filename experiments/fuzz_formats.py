"""Written stand-ins of every file that the library reads, and judges of what was read from them."""

import dataclasses
import gzip
import io
import json
import sys
import tempfile
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np

from experiments.fuzz_captures import LZFSE, captures
from experiments.fuzz_recordings import POSE, TUM, png_of, recordings, text_of
from sfgs_jax import factor_graph, gicp, sensors, slam, splatting, superfeats
from sfgs_jax.arrays import FrameError
from sfgs_jax.cli import RunConfig, read_config, to_json
from sfgs_jax.datasets import ReaderOptions, open_recording, read_pair_list, read_scannet_1500
from sfgs_jax.evaluation.images import PROTOCOLS, FrameFigures, format_frames, read_frames
from sfgs_jax.geometry import read_covariances, read_tum
from sfgs_jax.slam.run import read_tensors, write_tensors
from sfgs_jax.splatting.mesh import Mesh, load_mesh, save_mesh

_LARGEST = 1e12
"""Beyond it a number that was read is garbage."""


@dataclass(frozen=True)
class Format:
    """A file format, or the layout of a recording.

    Attributes:
        files: the contents of its files by their paths.
        targets: the files that are damaged.
        load: reads the folder of these files, or the first of them; raises if what it got is garbage.
    """

    files: Mapping[str, bytes]
    targets: tuple[str, ...]
    load: Callable[[Path], Any]


class Garbage(Exception):
    """Something was read that no such file can mean, and nothing warned of it."""


def formats() -> dict[str, Format]:
    """All formats by name."""
    return {**_recordings(), **_captures(), **_single_files()}


def _recordings() -> dict[str, Format]:
    return {name: Format(files, _targets(files), _recording) for name, files in recordings().items()}


def _captures() -> dict[str, Format]:
    found = {}
    for name, files in captures().items():
        # A single file is opened itself, a bag of ROS 2 by its folder.
        first = next(iter(files))
        place = "" if len(files) > 1 and not name.startswith("ROS 2") else first.split("/")[0]
        found[name] = Format(files, _targets(files), _of_file(place, _capture))
    return found


def _capture(path: Path) -> None:
    with mock.patch.dict(sys.modules, liblzfse=LZFSE):
        _recording(path)


def judged(value: Any) -> Any:
    """The value. Raises Garbage if it holds a number that is not finite, or far too large."""
    for leaf in jax.tree.leaves(value):
        array = np.asarray(leaf)
        if array.dtype.kind in "fc" and not np.all(np.abs(array) < _LARGEST):
            raise Garbage("a number is not finite, or beyond 1e12")
    return value


def _recording(folder: Path) -> None:
    own = folder / "own.json"
    recording = open_recording(folder, options=ReaderOptions(camera=own if own.is_file() else None))
    warned = bool(recording.notes)
    judged(np.asarray(recording.camera.matrix()))
    if not np.asarray(recording.camera.matrix())[[0, 1], [0, 1]].min() > 0:
        raise Garbage("a focal length is not positive")
    judged(recording.timestamps)
    if recording.ground_truth is not None:
        judged(recording.ground_truth.poses)
    for i in range(len(recording)):
        try:
            frame = recording[i]
        except FrameError:
            continue
        judged((frame.rgb, frame.depth))
        if not warned and np.max(frame.depth) > 1e6:
            raise Garbage("depth beyond 1000 km")


def _targets(files: Mapping[str, bytes]) -> tuple[str, ...]:
    """All small files, and the first image of each kind. Text has more to damage, so it counts twice."""
    small = [
        name
        for name in files
        if name.endswith((".txt", ".json", ".csv", ".yaml", ".log", ".freiburg", "metadata"))
    ]
    images = {
        name.rpartition("/")[0] or name: name for name in sorted(files, reverse=True) if name not in small
    }
    return (*small, *small, *images.values())


_File = tuple[str, bytes, Callable[[Path], Any]]
"""Name and content of a file, and how it is read."""


def _single_files() -> dict[str, Format]:
    files = {**_map_files(), **_shape_files(), **_run_files()}
    single = {
        name: Format({file: content}, (file,), _of_file(file, load))
        for name, (file, content, load) in files.items()
    }
    return {**single, "pair list": _pair_list(), "ScanNet-1500 npz": _scannet_pairs()}


def _map_files() -> dict[str, _File]:
    random = np.random.default_rng(1)
    n = 8
    gaussians = splatting.Gaussians(
        jnp.asarray(random.normal(size=(n, 3)), jnp.float32),
        jnp.asarray(np.tile([1.0, 0, 0, 0], (n, 1)), jnp.float32),
        jnp.asarray(np.full((n, 3), -3), jnp.float32),
        jnp.asarray(np.zeros(n), jnp.float32),
        jnp.asarray(random.normal(size=(n, 4, 3)), jnp.float32),
        jnp.asarray(np.ones(n, bool)),
    )
    return {
        "splat PLY": ("map.ply", _written(splatting.save_ply, gaussians), _gaussians(splatting.load_ply)),
        ".splat": ("map.splat", _written(splatting.save_splat, gaussians), _gaussians(splatting.load_splat)),
        "SPZ": ("map.spz", _written(splatting.save_spz, gaussians), _gaussians(splatting.load_spz)),
        "glTF with splats": (
            "map.glb",
            _written(splatting.save_gltf, gaussians),
            _gaussians(splatting.load_gltf),
        ),
        "coloured points": (
            "points.ply",
            _written(splatting.save_points, gaussians),
            lambda path: judged(splatting.load_coloured_points(path)[0]),
        ),
        "SPZ, within gzip": (
            "map.raw",
            gzip.decompress(_written(splatting.save_spz, gaussians)),
            _gaussians(_load_raw_spz),
        ),
    }


def _shape_files() -> dict[str, _File]:
    points = np.random.default_rng(1).normal(size=(20, 3))
    return {
        "glTF, a mesh": ("mesh.glb", _mesh_glb(points), lambda path: judged(load_mesh(path).vertices)),
        "points, PLY": ("p.ply", _points_ply(points), _points),
        "points, XYZ": ("p.xyz", text_of(points).encode(), _points),
        "mesh, OBJ": ("m.obj", _mesh_obj(points), _points),
        "mesh, OFF": ("m.off", b"OFF\n20 1 0\n" + text_of(points).encode() + b"3 0 1 2\n", _points),
        "mesh, STL": ("m.stl", bytes(80) + (4).to_bytes(4, "little") + bytes(4 * 50), _points),
    }


def _run_files() -> dict[str, _File]:
    config = RunConfig("synthetic", "synthetic", ReaderOptions(), slam.SlamConfig(), None)
    tensors = {"a": np.arange(40, dtype=np.float32), "b": np.asarray(5), "c": np.zeros((0, 7))}
    weights = superfeats.load_weights()
    return {
        "g2o": ("graph.g2o", _graph().encode(), _graph_of),
        "weights": (
            "weights.safetensors",
            _written(superfeats.save_weights, weights),
            lambda path: judged(superfeats.load_weights(path)),
        ),
        "config.json": ("config.json", to_json(config).encode(), _config),
        "sensors.json": (
            "sensors.json",
            json.dumps(
                {
                    "times_s": {"depth_delay": 0.01, "colour_readout": 0.02, "depth_readout": 0.0},
                    "depth_offsets_per_m": np.zeros(sensors.DEPTH_GRID).tolist(),
                }
            ).encode(),
            lambda path: judged(sensors.read_sensors(path)),
        ),
        "exposure.txt": ("exposure.txt", b"# t r g b\n0.0 1.0 1.1 0.9\n0.1 1.0 1.0 1.0\n", _gains),
        "background.txt": ("background.txt", b"# r g b\n" + b"0.1 -0.2 0.3\n" * 9, _background),
        "frames.csv": ("frames.csv", _frames().encode(), read_frames),
        "trajectory.txt": ("trajectory.txt", TUM.encode(), lambda path: judged(read_tum(path).poses)),
        "trajectory_covariance.txt": (
            "trajectory_covariance.txt",
            "".join(f"{i}.0 " + " ".join(["1e-6"] * 21) + "\n" for i in range(3)).encode(),
            lambda path: judged(read_covariances(path)),
        ),
        "state file": (
            "state.safetensors",
            _written(lambda path, x: write_tensors(path, x, {"version": "1"}), tensors),
            _tensors(tensors),
        ),
    }


def _frames() -> str:
    figures = [
        FrameFigures(i, i / 30, not i, {PROTOCOLS[0]: 22.0}, {PROTOCOLS[0]: 0.8}, 0.02, 0.99, None)
        for i in range(3)
    ]
    return format_frames(figures, {0: 0.01}, {i: np.ones(3) for i in range(3)})


def _of_file(file: str, load: Callable[[Path], Any]) -> Callable[[Path], Any]:
    return lambda folder: load(folder / file)


def _written(save: Callable[[Path, Any], None], value: Any) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        save(Path(folder) / "file", value)
        return (Path(folder) / "file").read_bytes()


def _mesh_glb(points: np.ndarray) -> bytes:
    mesh = Mesh(points, np.array([[0, 1, 2], [3, 4, 5]]), np.full(points.shape, 0.5))
    with tempfile.TemporaryDirectory() as folder:
        save_mesh(path := Path(folder) / "mesh.glb", mesh)
        return path.read_bytes()


def _gaussians(load: Callable[[Path], splatting.Gaussians]) -> Callable[[Path], None]:
    def read(path: Path) -> None:
        found = judged(load(path))
        if np.max(np.asarray(found.log_scales), initial=0) > 20:
            raise Garbage("a Gaussian is larger than a country")

    return read


def _load_raw_spz(path: Path) -> splatting.Gaussians:
    packed = path.with_suffix(".spz")
    packed.write_bytes(gzip.compress(path.read_bytes(), 1))
    return splatting.load_spz(packed)


def _graph() -> str:
    information = " ".join(["100 0 0 0 0 0", "100 0 0 0 0", "100 0 0 0", "100 0 0", "100 0", "100"])
    lines = [f"VERTEX_SE3:QUAT {i} {i} 0 0 0 0 0 1" for i in range(4)]
    lines += ["FIX 0", *(f"EDGE_SE3:QUAT {i} {i + 1} 1 0 0 0 0 0 1 {information}" for i in range(3))]
    return "\n".join(lines) + "\n"


def _graph_of(path: Path) -> None:
    graph = factor_graph.read_g2o(path)
    judged((graph.values.poses.wxyz_xyz, graph.edges.T_a_b.wxyz_xyz))
    if len(graph.edges.matrices) and not np.linalg.eigvalsh(np.asarray(graph.edges.matrices)).min() > -1e-3:
        raise Garbage("information is not positive semi-definite")


def _config(path: Path) -> None:
    config = read_config(path)
    for value in jax.tree.leaves(dataclasses.asdict(config)):
        if isinstance(value, float) and not np.isfinite(value):
            raise Garbage("a setting is not finite")


def _background(path: Path) -> None:
    judged(splatting.read_background(path))


def _gains(path: Path) -> None:
    judged(sensors.read_gains(path))


def _points(path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        judged(gicp.load_points(path))


def _points_ply(points: np.ndarray) -> bytes:
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    header += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    return header.encode() + points.astype("<f4").tobytes()


def _mesh_obj(points: np.ndarray) -> bytes:
    return ("".join(f"v {x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in points) + "f 1 2 3\nf 2 3 4\n").encode()


def _tensors(written: Mapping[str, np.ndarray]) -> Callable[[Path], None]:
    def read(path: Path) -> None:
        found, metadata = read_tensors(path)
        same = found.keys() == written.keys() and all(
            np.array_equal(found[key], value) for key, value in written.items()
        )
        if not same or metadata["version"] != "1":
            raise Garbage("other values than were written")

    return read


def _pair_list() -> Format:
    numbers = "0 0 20 0 12 0 20 8 0 0 1 20 0 12 0 20 8 0 0 1 1 0 0 0.5 0 1 0 0 0 0 1 0 0 0 0 1"
    image = png_of(np.zeros((4, 4, 3), np.uint8))
    files = {
        "pairs.txt": f"a.png b.png {numbers}\nb.png a.png {numbers}\n".encode(),
        "a.png": image,
        "b.png": image,
    }
    return Format(files, ("pairs.txt",), lambda folder: _pairs(read_pair_list(folder / "pairs.txt")))


def _pairs(pairs: list) -> None:
    for pair in pairs:
        judged((pair.K_a, pair.K_b, pair.T_b_a))
        if not min(pair.K_a[0, 0], pair.K_a[1, 1], pair.K_b[0, 0], pair.K_b[1, 1]) > 0:
            raise Garbage("a focal length is not positive")


def _scannet_pairs() -> Format:
    content = io.BytesIO()
    np.savez(content, name=np.array([[707, 0, 0, 15]]))
    scene = "scannet_test_1500/scene0707_00"
    image = png_of(np.zeros((4, 4, 3), np.uint8))
    other = POSE + np.diag([0, 0, 0.5], 1)
    files = {
        "test.npz": content.getvalue(),
        f"{scene}/intrinsic/intrinsic_color.txt": b"20 0 12\n0 20 8\n0 0 1\n",
        f"{scene}/pose/0.txt": text_of(POSE).encode(),
        f"{scene}/pose/15.txt": text_of(other).encode(),
        f"{scene}/color/0.jpg": image,
        f"{scene}/color/15.jpg": image,
    }
    return Format(files, tuple(files)[:4], lambda folder: _pairs(read_scannet_1500(folder)))
