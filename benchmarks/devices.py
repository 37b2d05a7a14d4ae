"""Hot paths on each device that JAX has: times of the first call and of later ones, and how results differ.

    python -m benchmarks.devices [--devices cpu cuda] [--only NAME ...] [--calls 20]

Each device is measured in a process of its own, one after the other. *First* is the time to the first result:
most of it is compilation, the rest makes the inputs. *ms* is the median of later calls, waited for, with
inputs that are on the device. *Apart* is the relative distance of the floating-point results from the first
device's, ||a - b|| / ||a||. Frames are of the synthetic room, so that no recording is needed.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import gate
from benchmarks.steps import steps_of
from sfgs_jax import datasets, slam, superfeats
from sfgs_jax.geometry import Frame

Call = Callable[[], Any]
SEQUENCE = 30
BATCH = 8


def frames_of(count: int, width: int = 320, height: int = 240, seed: int = 0) -> list[Frame]:
    """Frames of the synthetic room with the noise of a Kinect."""
    room = datasets.SyntheticRecording(num_frames=240, width=width, height=height, noise=True, seed=seed)
    return [room[i] for i in range(count)]


def registration() -> Call:
    """The motion from a depth image of 640 x 480 to another."""
    call = gate.registration()
    return lambda: call().T_target_source.wxyz_xyz


def extraction() -> Call:
    """Descriptors of the keypoints of an image of 640 x 480."""
    call = gate.extraction()
    return lambda: call().descriptors


def tracking(width: int, height: int) -> Call:
    """A tracking step."""
    call = gate.tracked(gate.recording(width, height), gate.synthetic_camera(width, height))
    return lambda: call()[1].T_world_cam.wxyz_xyz


def sequences(batch: int) -> Call:
    """Tracking of so many recordings at 320 x 240, as one program: poses (B, N, 7)."""
    recordings = [frames_of(SEQUENCE, seed=seed) for seed in range(batch)]
    params = slam.tracker_params(gate.synthetic_camera(320, 240), slam.TrackingConfig())
    rgb = jnp.asarray([[frame.rgb for frame in row] for row in recordings])
    depth = jnp.asarray([[frame.depth for frame in row] for row in recordings])
    elapsed = jnp.full((batch, SEQUENCE), 1 / 30, jnp.float32).at[:, 0].set(0)
    tracker = slam.init_tracker(params)

    @jax.jit
    @jax.vmap
    def tracked(rgb: jax.Array, depth: jax.Array, elapsed: jax.Array) -> jax.Array:
        _, sequence = slam.track_sequence(params, tracker, rgb, depth, elapsed, rematerialise=False)
        return sequence.T_world_cam.wxyz_xyz

    return lambda: tracked(rgb, depth, elapsed)


def rendering() -> Call:
    """An image of 640 x 480 of 77,000 Gaussians."""
    call = gate.rendering()
    return lambda: call().rgb


@cache
def steps_of_a_run(width: int, height: int) -> dict[str, Call]:
    """Calls of the compiled steps on the state of a run."""
    state = slam.init(gate.synthetic_camera(width, height), slam.SlamConfig())
    frames = frames_of(SEQUENCE, width, height)
    for frame in frames:
        state, _ = slam.step(state, frame)
    return steps_of(state, np.asarray(superfeats.mean_grey(frames[-1].rgb)), np.asarray(frames[-1].depth))


def adjustment() -> Call:
    """Poses of an adjusted window."""
    call = steps_of_a_run(320, 240)["adjust"]
    return lambda: call().solution.values.poses.wxyz_xyz


def mapping(width: int, height: int) -> Call:
    """Means of the Gaussians after a map step."""
    call = steps_of_a_run(width, height)["map_step"]
    return lambda: call().map.gaussians.means


def optimum() -> Call:
    """The poses and landmarks of a bundle adjustment."""
    call = gate.bundle_adjustment()
    return lambda: call().values


CALLS: dict[str, tuple[Callable[[], Call], int]] = {
    "prepare and align, 640x480": (registration, 1),
    "extract 1024 keypoints, 640x480": (extraction, 1),
    "match 1024 with 1024": (gate.matching, 1),
    "track, 320x240": (lambda: tracking(320, 240), 1),
    "track, 640x480": (lambda: tracking(640, 480), 1),
    f"a frame of {SEQUENCE}, tracked in a scan, 320x240": (lambda: sequences(1), SEQUENCE),
    f"the same, {BATCH} recordings at once": (lambda: sequences(BATCH), SEQUENCE * BATCH),
    "adjust a window": (adjustment, 1),
    "map step, 320x240": (lambda: mapping(320, 240), 1),
    "map step, 640x480": (lambda: mapping(640, 480), 1),
    "render 77,000 Gaussians, 640x480": (rendering, 1),
    "render and its gradient": (gate.rendering_gradient, 1),
    "bundle adjustment, 50 poses": (optimum, 1),
}
"""Name of each measurement, the function that prepares its call, and the frames that one call is for."""


def numbers_of(result: Any) -> np.ndarray:
    """All floating-point numbers of a result, in one row."""
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(result)]
    return np.concatenate([np.zeros(0), *(a.ravel() for a in leaves if np.issubdtype(a.dtype, np.floating))])


def measured(name: str, calls: int) -> tuple[float, float, np.ndarray]:
    """Seconds to the first result, seconds of a later call for one frame, and the numbers of the result."""
    start = time.perf_counter()
    prepare, frames = CALLS[name]
    call = prepare()
    result = jax.block_until_ready(call())
    first = time.perf_counter() - start
    return first, float(np.median([gate.seconds(call) for _ in range(calls)])) / frames, numbers_of(result)


def measure(names: list[str], calls: int, folder: Path) -> None:
    """Measure on this process's device; write the times, and the results as arrays."""
    times: dict[str, Any] = {"device": jax.devices()[0].device_kind}
    for number, name in enumerate(names):
        first, seconds, numbers = measured(name, calls)
        times[name] = (first, seconds)
        np.save(folder / f"{number}.npy", numbers)
        (folder / "times.json").write_text(json.dumps(times), encoding="utf-8")
        print(f"{times['device']}: {name}: {1e3 * seconds:.2f} ms", file=sys.stderr, flush=True)


def apart(folder: Path, other: Path) -> float:
    """Relative distance of two results, and 1 where their sizes differ."""
    a, b = np.load(folder), np.load(other)
    return float(np.linalg.norm(a - b) / max(np.linalg.norm(a), 1e-30)) if a.shape == b.shape else 1.0


def print_table(names: list[str], folders: list[Path]) -> None:
    """First and later calls on each device, and the distance of its results from the first device's."""
    times = [json.loads((folder / "times.json").read_text(encoding="utf-8")) for folder in folders]
    heads = [f"{t['device']}: first s | ms" for t in times]
    print("| " + " | ".join(["", *heads, *("apart" for _ in folders[1:])]) + " |")
    print("| --- " * (1 + 2 * len(folders) + len(folders[1:])) + "|")
    for number, name in enumerate(names):
        cells = [f"{t[name][0]:.1f} | {1e3 * t[name][1]:.2f}" for t in times]
        cells += [f"{apart(folders[0] / f'{number}.npy', f / f'{number}.npy'):.0e}" for f in folders[1:]]
        print("| " + " | ".join([name, *cells]) + " |")


def main() -> None:
    """Measure each device in a process of its own."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    default = list(dict.fromkeys(["cpu", jax.default_backend()]))
    parser.add_argument(
        "--devices", nargs="+", default=default, help="platforms of JAX, such as cpu and cuda"
    )
    parser.add_argument("--only", nargs="+", choices=list(CALLS), metavar="NAME", help="these alone")
    parser.add_argument("--calls", type=int, default=20, help="timed calls of each")
    parser.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    names = options.only or list(CALLS)
    if options.measure:
        measure(names, options.calls, options.measure)
        return
    with tempfile.TemporaryDirectory() as temporary:
        folders = [Path(temporary) / device for device in options.devices]
        for folder, device in zip(folders, options.devices, strict=True):
            folder.mkdir()
            command = [sys.executable, "-m", "benchmarks.devices", "--measure", str(folder), "--only", *names]
            environment = {**os.environ, "JAX_PLATFORMS": device, "XLA_PYTHON_CLIENT_PREALLOCATE": "false"}
            subprocess.run([*command, "--calls", str(options.calls)], env=environment, check=True)
        print_table(names, folders)


if __name__ == "__main__":
    main()
