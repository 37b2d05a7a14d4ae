"""Gate on speed: hot paths over fixed JAX programs in the same run, against a committed baseline.

    python -m benchmarks.gate [--only NAME ...] [--pairs 15] [--update]

A ratio is the time of one hot path over that of a yardstick, a program that has nothing to do with this
library. The two take turns, and the median of the pairs counts: what else the machine does strikes both.
Absolute times are not compared. benchmarks/baseline.json holds the value, the direction and the tolerance of
each ratio. On a quiet machine `--update` writes the measured values there.

A ratio that is worse than its tolerance allows is measured once more. If it still is, the exit status is 1.
Ratios that need a recording or a package that is not there are skipped, each with a line that says so.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from rich.console import Console
from rich.table import Table

from benchmarks.factor_graph import corridor
from sfgs_jax import datasets, factor_graph, gicp, slam, splatting, superfeats
from sfgs_jax.arrays import checked
from sfgs_jax.geometry import Frame, se3, surface

BASELINE = Path(__file__).with_name("baseline.json")
PAIRS = 15
TURN_SECONDS = 0.04
"""A turn repeats a call until it takes about this long, so that clocks and threads' starts don't count."""
PAUSE_SECONDS = 0.1
HIGHEST = jax.lax.Precision.HIGHEST

Call = Callable[[], Any]
Direction = Literal["lower", "higher"]


class Skipped(Exception):
    """A recording or a package that a ratio needs is not there."""


@dataclass(frozen=True)
class Entry:
    """A line of the baseline.

    Attributes:
        value: the ratio.
        direction: whether lower or higher is better.
        tolerance: share of the value by which a ratio may be worse.
    """

    value: float
    direction: Direction
    tolerance: float

    def change(self, measured: float) -> float:
        """Share by which a measured ratio is worse; negative where it is better."""
        worse = measured / self.value - 1
        return worse if self.direction == "lower" else -worse

    def allows(self, measured: float) -> bool:
        """Whether a measured ratio is within the tolerance."""
        return self.change(measured) <= self.tolerance


def load_baseline(path: Path = BASELINE) -> dict[str, Entry]:
    """Entries by name."""
    return {name: Entry(**entry) for name, entry in json.loads(path.read_text(encoding="utf-8")).items()}


def save_baseline(entries: dict[str, Entry], path: Path = BASELINE) -> None:
    """Write the entries with values to four digits."""
    rounded = {name: vars(replace(e, value=float(f"{e.value:.4g}"))) for name, e in entries.items()}
    path.write_text(json.dumps(rounded, indent=2) + "\n", encoding="utf-8")


def seconds(call: Call, repetitions: int = 1) -> float:
    begin = time.perf_counter()
    for _ in range(repetitions):
        jax.block_until_ready(call())
    return (time.perf_counter() - begin) / repetitions


def median_ratio(call: Call, yardstick: Call, pairs: int) -> float:
    """Median of the ratios of turns that follow each other."""
    seconds(call)
    seconds(yardstick)
    counts = [max(1, round(TURN_SECONDS / seconds(c))) for c in (call, yardstick)]
    ratios = []
    for _ in range(pairs):
        above, below = (turn(c, count) for c, count in zip((call, yardstick), counts, strict=True))
        ratios.append(above / below)
    return float(np.median(ratios))


def turn(call: Call, repetitions: int) -> float:
    """Seconds a call takes in its turn.

    The pause lets the threads of the call before come to rest: those of onnxruntime spin for a while. The
    first call after a pause is slow, and does not count.
    """
    time.sleep(PAUSE_SECONDS)
    seconds(call)
    return seconds(call, repetitions)


# Yardsticks: each works as the hot paths beside it do.


@cache
def product() -> Call:
    """A product of two matrices of 1024 x 1024."""
    a = jax.random.normal(jax.random.key(0), (1024, 1024))
    program = jax.jit(lambda a: jnp.matmul(a, a, precision=HIGHEST))
    return lambda: program(a)


@cache
def convolution() -> Call:
    """A 3 x 3 convolution of 32 to 32 channels at 160 x 120."""
    image = jax.random.normal(jax.random.key(0), (1, 120, 160, 32))
    kernel = jax.random.normal(jax.random.key(1), (3, 3, 32, 32))

    @jax.jit
    def program(image: jax.Array, kernel: jax.Array) -> jax.Array:
        layout = ("NHWC", "HWIO", "NHWC")
        return jax.lax.conv_general_dilated(image, kernel, (1, 1), "SAME", dimension_numbers=layout)

    return lambda: program(image, kernel)


@cache
def exponentials() -> Call:
    """Four million exponentials, added up in rows."""
    x = jax.random.normal(jax.random.key(0), (2048, 2048))
    program = jax.jit(lambda x: jnp.exp(-x * x).sum(axis=1))
    return lambda: program(x)


# What is measured. Each function prepares its inputs and returns the call.


@cache
def recording(width: int, height: int) -> list[Frame]:
    """Two frames of the synthetic room, five apart, with the noise of a Kinect."""
    made = datasets.SyntheticRecording(num_frames=120, width=width, height=height, noise=True)
    return [made[0], made[5]]


def synthetic_camera(width: int, height: int) -> Any:
    return datasets.SyntheticRecording(num_frames=1, width=width, height=height).camera


def extraction() -> Call:
    params, image = superfeats.load_weights(), jnp.asarray(recording(640, 480)[0].rgb)
    return lambda: superfeats.extract(params, image, max_keypoints=1024)


def matching() -> Call:
    params = superfeats.load_weights()
    a, b = (superfeats.extract(params, frame.rgb, max_keypoints=1024) for frame in recording(640, 480))
    return lambda: superfeats.match(a, b)


def registration() -> Call:
    camera = synthetic_camera(640, 480)
    target, source = (jnp.asarray(frame.depth) for frame in recording(640, 480))
    cloud = gicp.prepare(target, camera)
    return lambda: gicp.align(gicp.prepare(source, camera), cloud, se3.identity())


def tracked(frames: list[Frame], camera: Any) -> Call:
    """A tracking step: the second frame in the first."""
    params = slam.tracker_params(camera, slam.TrackingConfig())
    images = [(jnp.asarray(f.rgb), jnp.asarray(f.depth)) for f in frames]
    tracker, _ = slam.track(params, slam.init_tracker(params), *images[0], jnp.float32(0))
    return lambda: slam.track(params, tracker, *images[1], jnp.float32(1 / 30))


def tracking() -> Call:
    return tracked(recording(320, 240), synthetic_camera(320, 240))


@cache
def scene() -> tuple[splatting.Gaussians, Any, splatting.RenderConfig]:
    """A Gaussian for each second row and column of a depth image, seen at 640 x 480."""
    camera, frame = synthetic_camera(640, 480), recording(640, 480)[0]
    small = camera.downscaled(2)
    found = surface(np.asarray(frame.depth)[::2, ::2], small)
    means = found.points.reshape(-1, 3)
    gaussians = splatting.Gaussians(
        means=means,
        quaternions=jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (len(means), 1)),
        log_scales=jnp.tile(jnp.log(jnp.maximum(means[:, 2:], 0.1) / small.fx), (1, 3)),
        opacity_logits=jnp.full(len(means), 2.0),
        sh=splatting.rgb_to_sh(jnp.asarray(frame.rgb)[::2, ::2].reshape(-1, 1, 3)),
        valid=found.valid.reshape(-1),
    )
    room = splatting.pair_capacity(gaussians, camera, se3.identity())
    return gaussians, camera, splatting.RenderConfig(pair_capacity=room)


def rendering() -> Call:
    gaussians, camera, config = scene()
    return lambda: splatting.render(gaussians, camera, se3.identity(), config=config)


@cache
def rendering_gradient() -> Call:
    gaussians, camera, config = scene()

    @jax.jit
    def gradient(means: jax.Array, gaussians: splatting.Gaussians) -> jax.Array:
        def loss(means: jax.Array) -> jax.Array:
            moved = replace(gaussians, means=means)
            return splatting.render(moved, camera, se3.identity(), config=config).rgb.mean()

        return jax.grad(loss)(means)

    return lambda: gradient(gaussians.means, gaussians)


def bundle_adjustment() -> Call:
    factors, values = corridor(50)
    graph = factor_graph.FactorGraph(factors, num_poses=50, num_landmarks=len(values.landmarks))
    placed = jax.tree.map(jnp.asarray, graph)
    return lambda: factor_graph.solve(placed, values)


def argument_checks() -> Call:
    """A hundred calls of a public function that does nothing but check its arguments."""

    @checked
    def function(
        points: Float[jax.Array | np.ndarray, "N 3"],
        depth: Float[jax.Array | np.ndarray, "H W"],
        used: Bool[jax.Array | np.ndarray, " N"] | None = None,
        *,
        width: float = 1.0,
    ) -> None:
        pass

    points, depth, used = jnp.zeros((100, 3)), np.zeros((48, 64), np.float32), jnp.ones(100, bool)

    def calls() -> None:
        for _ in range(100):
            function(points, depth, used, width=2.0)

    return calls


def data_root() -> Path:
    return Path(os.environ.get("SFGS_DATA", Path(__file__).parents[2] / "shared"))


@cache
def kitchen() -> tuple[list[Frame], Any]:
    """Two frames of RedKitchen, five apart."""
    folder = data_root() / "data" / "7scenes" / "redkitchen"
    if not folder.is_dir():
        raise Skipped(f"no RedKitchen at {folder}; set SFGS_DATA")
    made = datasets.open_recording(str(folder))
    return [made[0], made[5]], made.camera


def xfeat() -> Call:
    """XFeat in onnxruntime: extraction from a RedKitchen image."""
    try:
        from experiments.xfeat import XFeat, default_weights
        from experiments.xfeat_size import resized_xfeat
    except ImportError as error:
        raise Skipped(f"{error.name} is not installed") from error
    frames, camera = kitchen()
    if not default_weights().is_file():
        raise Skipped(f"no weights of XFeat at {default_weights()}")
    network = XFeat(resized_xfeat(default_weights(), camera.height, camera.width))
    return lambda: network.extract(np.asarray(frames[0].rgb), max_keypoints=1024)


def real_extraction() -> Call:
    frames, _ = kitchen()
    params, image = superfeats.load_weights(), jnp.asarray(frames[0].rgb)
    return lambda: superfeats.extract(params, image, max_keypoints=1024)


def real_tracking() -> Call:
    return tracked(*kitchen())


def import_of(module: str) -> Call:
    """The import of a module in a new interpreter; returns the seconds it took."""
    code = f"import time; t = time.perf_counter(); import {module}; print(time.perf_counter() - t)"
    return lambda: float(subprocess.check_output([sys.executable, "-c", code], text=True))


def import_ratio(pairs: int) -> float:
    ours, theirs = import_of("sfgs_jax"), import_of("jax.numpy")
    ratios = [ours() / theirs() for _ in range(1 + max(3, pairs // 3))]
    return float(np.median(ratios[1:]))  # the first import reads the files from the disk


def over(call: Callable[[], Call], yardstick: Callable[[], Call]) -> Callable[[int], float]:
    return lambda pairs: median_ratio(call(), yardstick(), pairs)


RATIOS: dict[str, Callable[[int], float]] = {
    "extract / convolution": over(extraction, convolution),
    "match / product": over(matching, product),
    "prepare and align / exponentials": over(registration, exponentials),
    "track / convolution": over(tracking, convolution),
    "render / exponentials": over(rendering, exponentials),
    "render and gradient / exponentials": over(rendering_gradient, exponentials),
    "bundle adjustment / product": over(bundle_adjustment, product),
    "argument checks / product": over(argument_checks, product),
    "import sfgs_jax / import jax": import_ratio,
    "XFeat / extract, real": over(xfeat, real_extraction),
    "track / XFeat, real": over(real_tracking, xfeat),
}


def verdict(entry: Entry | None, measured: float) -> str:
    if entry is None:
        return "new: no baseline"
    if not entry.allows(measured):
        return "WORSE"
    return "better: --update" if entry.change(measured) < -entry.tolerance else "ok"


def measure(names: list[str], baseline: dict[str, Entry], pairs: int) -> dict[str, float]:
    """Ratios by name; each that is worse than allowed is measured twice, and the better one counts."""
    found: dict[str, float] = {}
    for name in names:
        try:
            found[name] = RATIOS[name](pairs)
        except Skipped as reason:
            print(f"skipped {name}: {reason}", flush=True)
            continue
        entry = baseline.get(name)
        if entry is not None and not entry.allows(found[name]):
            found[name] = min(found[name], RATIOS[name](2 * pairs), key=entry.change)
        print(f"measured {name}: {found[name]:.3g}", flush=True)
    return found


def table_of(found: dict[str, float], baseline: dict[str, Entry]) -> Table:
    table = Table(title="Hot paths over yardsticks of the same run")
    for column in ("ratio", "measured", "baseline", "better", "worse by", "allowed", ""):
        table.add_column(column, justify="left" if column in ("ratio", "") else "right")
    for name, measured in found.items():
        entry = baseline.get(name)
        cells = ["", "", "", ""]
        if entry is not None:
            change = f"{entry.change(measured):+.0%}"
            cells = [f"{entry.value:.3g}", entry.direction, change, f"{entry.tolerance:.0%}"]
        table.add_row(name, f"{measured:.3g}", *cells, verdict(entry, measured))
    return table


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--only", nargs="+", choices=list(RATIOS), metavar="NAME", help="these ratios alone")
    parser.add_argument("--pairs", type=int, default=PAIRS, help="turns of each ratio")
    parser.add_argument("--update", action="store_true", help="write the measured values to the baseline")
    arguments = parser.parse_args()
    baseline = load_baseline()
    found = measure(arguments.only or list(RATIOS), {} if arguments.update else baseline, arguments.pairs)
    Console(width=120).print(table_of(found, baseline))
    if arguments.update:
        measured = {name: replace(baseline[name], value=value) for name, value in found.items()}
        save_baseline({**baseline, **measured})
        return 0
    return int(any(name in baseline and not baseline[name].allows(value) for name, value in found.items()))


if __name__ == "__main__":
    sys.exit(main())
