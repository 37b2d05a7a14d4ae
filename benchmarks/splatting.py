"""The renderer's times beside the floors of the same machine.

    python -m benchmarks.splatting            everything below
    python -m benchmarks.splatting scene      times at 640x480 and 320x240
    python -m benchmarks.splatting growth     time against the number of Gaussians and the size of the image
    python -m benchmarks.splatting memory     peak memory with 100,000 Gaussians at 640x480
    python -m benchmarks.splatting oracle     images and gradients beside the dense reference, at 641x479

Each part runs in its own process. Times are medians of warm calls on `data/bench/splat_scene_50k.npz` (50,000
Gaussians of one real frame), found through SFGS_DATA or at ../shared.

The floor of a time is its arithmetic at the rates of `exp` and of a matrix product, measured in the same run.
A rendering needs one exponential for each pair of a Gaussian and a pixel of its tiles. Its gradient needs one
more exponential and ten sums.
"""

import os
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jax import Array
from scipy.optimize import nnls

from sfgs_jax.arrays import InputError
from sfgs_jax.geometry import Camera, se3
from sfgs_jax.splatting import (
    Gaussians,
    RenderConfig,
    bin_into_tiles,
    composite,
    l1,
    pair_capacity,
    project,
    render,
    rgb_to_sh,
    ssim,
)
from tests.splatting.scenes import make_camera, make_pose, make_scene, run

REPEATS = 15
ROUNDS = 7
COUNTS = (10_000, 30_000, 100_000, 300_000, 1_000_000)

BORDERLINE = 2e-5
"""Largest difference of images by rounding. Above it, one renderer drew a Gaussian that the other skipped."""

Tree = TypeVar("Tree")


@dataclass(frozen=True)
class View:
    """Gaussians, and a camera that looks at them."""

    gaussians: Gaussians
    camera: Camera
    T_world_cam: jaxlie.SE3
    target: Array

    def smaller(self, factor: int) -> "View":
        """The same in a smaller image, of means of factor x factor pixels."""
        camera = self.camera.downscaled(factor)
        target = self.target.reshape(camera.height, factor, camera.width, factor, 3).mean((1, 3))
        return replace(self, camera=camera, target=target)

    def larger(self, factor: int) -> "View":
        """The same in a larger image, with factor x factor pixels for each."""
        c = self.camera
        shift = (factor - 1) / 2
        camera = Camera(
            factor * c.fx,
            factor * c.fy,
            factor * c.cx + shift,
            factor * c.cy + shift,
            width=factor * c.width,
            height=factor * c.height,
        )
        target = jnp.repeat(jnp.repeat(self.target, factor, axis=0), factor, axis=1)
        return replace(self, camera=camera, target=target)

    def resampled(self, count: int) -> "View":
        """The same surfaces with `count` Gaussians, drawn at random; more Gaussians are smaller."""
        rng = np.random.default_rng(0)
        old = self.gaussians.means.shape[0]
        chosen = rng.integers(0, old, count) if count > old else rng.permutation(old)[:count]
        gaussians = jax.tree.map(lambda values: values[chosen], self.gaussians)
        shift = 0.5 * np.exp(gaussians.log_scales) * rng.normal(size=(count, 3)) * (count > old)
        gaussians = replace(
            gaussians,
            means=gaussians.means + jnp.asarray(shift, jnp.float32),
            log_scales=gaussians.log_scales + 0.5 * float(np.log(old / count)),
        )
        return replace(self, gaussians=gaussians)

    def shaken(self) -> "View":
        """The same with no two Gaussians at one depth, whose order rounding would decide, and none round."""
        rng, shape = np.random.default_rng(1), self.gaussians.means.shape
        millimetres, logarithms = (jnp.asarray(rng.normal(size=shape), jnp.float32) for _ in range(2))
        gaussians = replace(
            self.gaussians,
            means=self.gaussians.means + 1e-3 * millimetres,
            log_scales=self.gaussians.log_scales + 0.5 * logarithms,
        )
        return replace(self, gaussians=gaussians)

    def config(self) -> RenderConfig:
        return RenderConfig(pair_capacity=pair_capacity(self.gaussians, self.camera, self.T_world_cam))

    def forward(self, config: RenderConfig) -> Callable:
        return lambda gaussians: render(gaussians, self.camera, self.T_world_cam, config=config)

    def gradient(self, config: RenderConfig) -> Callable:
        def loss(gaussians: Gaussians) -> Array:
            out = self.forward(config)(gaussians)
            return l1(out.rgb, self.target) + jnp.mean(out.accumulated_depth)

        return jax.value_and_grad(loss, allow_int=True)

    def bins(self, config: RenderConfig) -> Callable:
        return lambda projected: bin_into_tiles(
            projected,
            width=self.camera.width,
            height=self.camera.height,
            tile_size=config.tile_size,
            pair_capacity=config.pair_capacity,
        )


def load_view() -> View:
    """The scene of the data folder, with pixel centres at integer coordinates."""
    root = Path(os.environ.get("SFGS_DATA", Path(__file__).parents[2] / "shared"))
    path = root / "data" / "bench" / "splat_scene_50k.npz"
    if not path.is_file():
        raise InputError(f"No benchmark scene at {path}; set SFGS_DATA to the folder that holds data/.")
    data = np.load(path)
    K, opacities = data["K"], jnp.asarray(data["opacities"])
    gaussians = Gaussians(
        means=jnp.asarray(data["means"]),
        quaternions=jnp.asarray(data["quats"]),
        log_scales=jnp.log(jnp.asarray(data["scales"])),
        opacity_logits=jnp.log(opacities / (1 - opacities)),
        sh=rgb_to_sh(jnp.asarray(data["colors"]))[:, None],
        valid=jnp.ones(len(opacities), bool),
    )
    width, height = int(data["width"]), int(data["height"])
    camera = Camera(K[0, 0], K[1, 1], K[0, 2] - 0.5, K[1, 2] - 0.5, width=width, height=height)
    T_world_cam = se3.from_matrix(np.linalg.inv(data["viewmat"].astype(np.float64)))
    return View(gaussians, camera, T_world_cam, jnp.asarray(data["target"]))


@dataclass(frozen=True)
class Cost:
    """Cost of a program: median of a warm call, compilation, scratch memory."""

    ms: float
    compile_s: float
    scratch_mb: float


def measure(function: Callable, *args, repeats: int = REPEATS) -> Cost:
    start = time.perf_counter()
    program = jax.jit(function).lower(*args).compile()
    compile_s = time.perf_counter() - start
    analysis = program.memory_analysis()
    times = []
    for repeat in range(repeats + 2):
        start = time.perf_counter()
        jax.block_until_ready(program(*args))
        if repeat >= 2:
            times.append(time.perf_counter() - start)
    return Cost(
        1e3 * statistics.median(times), compile_s, analysis.temp_size_in_bytes / 1e6 if analysis else 0.0
    )


@dataclass(frozen=True)
class Rates:
    """The machine's rates, per millisecond."""

    exponentials: float
    flops: float

    @staticmethod
    def measured() -> "Rates":
        exponents, matrix = jnp.zeros((16_384, 1024)), jnp.ones((1536, 1536))
        exp_ms = measure(lambda x: jnp.sum(jnp.exp(x), axis=-1), exponents).ms
        matmul_ms = measure(lambda x: x @ x, matrix).ms
        rates = Rates(exponents.size / exp_ms, 2 * 1536**3 / matmul_ms)
        print(f"jax {jax.__version__} on {jax.devices()[0].platform}, {os.cpu_count()} cores: exp ", end="")
        print(f"{rates.exponentials / 1e6:.2f} G/s, matrix product {rates.flops / 1e6:.0f} GFLOP/s")
        return rates

    def floors(self, evaluations: int) -> tuple[float, float]:
        """Milliseconds of a rendering, and of one with its gradient."""
        forward = evaluations / self.exponentials
        return forward, 2 * forward + 20 * evaluations / self.flops


def count_pairs(view: View, config: RenderConfig) -> int:
    def count(gaussians: Gaussians) -> Array:
        projected, _ = project(gaussians, view.camera, view.T_world_cam)
        return jnp.sum(view.bins(config)(projected).counts)

    return int(jax.jit(count)(view.gaussians))


def scene_table(view: View, rates: Rates) -> None:
    config, gaussians, target = view.config(), view.gaussians, view.target
    width, height = view.camera.width, view.camera.height
    projected, colours = jax.jit(lambda g: project(g, view.camera, view.T_world_cam))(gaussians)
    lists = jax.jit(view.bins(config))(projected)
    columns = [projected.centres, projected.whitening, projected.log_opacities[:, None], colours]
    table = jnp.concatenate([*columns, projected.depths[:, None]], axis=1)
    weights = jax.random.normal(jax.random.key(0), (height, width, 5))

    def draw(table: Array) -> Array:
        images: tuple[Array, Array] = composite(table, lists, width, height, config.tile_size)
        return jnp.sum(weights * images[0])

    pairs = int(jnp.sum(lists.counts))
    floor, floor_gradient = rates.floors(pairs * config.tile_size**2)
    # SSIM takes nine blurs a channel: down by a matrix of 32 x 42, across by eleven products.
    floor_ssim = width * height * 3 * 9 * (2 * 42 + 2 * 11) / rates.flops
    mask = target[..., 0] > 0.2
    print(f"\n{width}x{height}: {pairs} pairs, room for {config.pair_capacity}")
    print(f"{'':34}{'ms':>9}{'floor':>9}{'ratio':>8}{'compile s':>11}{'scratch MB':>12}")
    rows = [
        ("forward", view.forward(config), gaussians, floor),
        ("forward + backward", view.gradient(config), gaussians, floor_gradient),
        ("  project", lambda g: project(g, view.camera, view.T_world_cam), gaussians, None),
        ("  bin into tiles", view.bins(config), projected, None),
        ("  composite", draw, table, floor),
        ("  composite + gradient", jax.grad(draw), table, floor_gradient),
        ("SSIM + gradient", jax.value_and_grad(lambda image: ssim(image, target)), target[::-1], floor_ssim),
        (
            "SSIM + gradient, masked",
            jax.value_and_grad(lambda image: ssim(image, target, mask)),
            target[::-1],
            floor_ssim,
        ),
        ("L1 + gradient", jax.value_and_grad(lambda image: l1(image, target)), target[::-1], None),
    ]
    for name, function, argument, bound in rows:
        cost = measure(function, argument)
        limits = f"{bound:9.1f}{cost.ms / bound:8.1f}" if bound else " " * 17
        print(f"{name:34}{cost.ms:9.1f}{limits}{cost.compile_s:11.1f}{cost.scratch_mb:12.1f}", flush=True)


def growth_table(views: list[View], rates: Rates) -> None:
    """Times against Gaussians and pairs, and the fit by one time a Gaussian and one a pair."""
    counts, programs = [], []
    for view in views:
        config = view.config()
        counts.append((view.gaussians.means.shape[0], count_pairs(view, config)))
        both = view.forward(config), view.gradient(config)
        programs.append([jax.jit(program).lower(view.gaussians).compile() for program in both])
    # In turns, so that all share a slow minute of the machine.
    times = np.zeros((1 + ROUNDS, len(views), 2))
    for turn in range(1 + ROUNDS):
        for i, (view, both) in enumerate(zip(views, programs, strict=True)):
            for j, program in enumerate(both):
                start = time.perf_counter()
                jax.block_until_ready(program(view.gaussians))
                times[turn, i, j] = 1e3 * (time.perf_counter() - start)
    measured = np.median(times[1:], axis=0)

    # Least squares of relative errors, because the times span two orders of magnitude.
    terms = np.asarray(counts)
    fits = [nnls(terms / measured[:, [j]], np.ones(len(views)))[0] for j in range(2)]
    head = f"{'pairs':>10}{'forward':>12}{'fit':>9}{'/ floor':>9}{'+ backward':>12}{'fit':>9}{'/ floor':>9}"
    print(f"\n{'Gaussians':>10}{'image':>12}{head}{'ns a pair':>11}")
    for view, row, ms in zip(views, counts, measured, strict=True):
        tile_pixels = row[1] * RenderConfig().tile_size ** 2
        print(f"{row[0]:10}{f'{view.camera.width}x{view.camera.height}':>12}{row[1]:10}", end="")
        for j, floor in enumerate(rates.floors(tile_pixels)):
            print(f"{ms[j]:12.1f}{np.dot(row, fits[j]):9.1f}{ms[j] / floor:9.1f}", end="")
        print(f"{1e6 * ms[1] / row[1]:11.0f}")
    for name, fit, ms in zip(("forward", "forward + backward"), fits, measured.T, strict=True):
        off = 100 * np.abs(terms @ fit / ms - 1)
        print(f"{name}: {1e6 * fit[0]:.0f} ns a Gaussian + {1e6 * fit[1]:.0f} ns a pair, ", end="")
        print(f"off by {np.sqrt(np.mean(off**2)):.0f} % RMS, {off.max():.0f} % at most")


def converted(tree: Tree, dtype: jnp.dtype) -> Tree:
    return jax.tree.map(lambda x: x if x.dtype == bool else jnp.asarray(x, dtype), tree)


def compare_with_oracle(name: str, scene: Gaussians, camera: Camera, T_world_cam: jaxlie.SE3) -> None:
    """Print the errors of the image and every gradient against the dense reference in float64."""

    def drawn(by: str, dtype: jnp.dtype, counted: np.ndarray | None = None) -> dict[str, np.ndarray]:
        with jax.enable_x64(dtype == jnp.float64):
            view = converted((scene, camera, T_world_cam), dtype)
            config = RenderConfig(pair_capacity=pair_capacity(view[0], view[1], view[2]))
            mask = None if counted is None else jnp.asarray(counted, jnp.float32)
            results = run(by, view[0], view[2], config, view[1], mask)
            return {what: np.asarray(values, np.float64) for what, values in results.items()}

    # A Gaussian with a contribution of 1/255 up to rounding is drawn by one renderer and not by the other.
    # Neither is wrong, so such pixels are left out.
    difference = np.abs(drawn("tiles", jnp.float32)["image"] - drawn("oracle", jnp.float64)["image"])
    counted = np.all(difference < BORDERLINE, axis=-1)
    expected = drawn("oracle", jnp.float64, counted)
    rows = [("tiles", jnp.float32), ("oracle", jnp.float32), ("tiles", jnp.float64)]
    results = [drawn(by, dtype, counted) for by, dtype in rows]
    print(f"{name}, {camera.width}x{camera.height}, {np.sum(~counted)} pixels left out")
    for what, b in expected.items():
        b = b[counted] if what == "image" else b
        print(f"  {what:16}", end="")
        for result in results:
            a = result[what][counted] if what == "image" else result[what]
            angle = 1 - np.vdot(a, b) / np.linalg.norm(a) / np.linalg.norm(b)
            print(f"{np.linalg.norm(a - b) / np.linalg.norm(b):16.1e}{angle:10.0e}", end="")
        print(flush=True)


def oracle_table(view: View) -> None:
    """Random Gaussians of every kind at full size, and real ones in an image that the reference can hold."""
    print("Relative error and 1 - cosine, against the dense reference in float64")
    print(f"{'':18}{'tiles float32':>26}{'reference float32':>26}{'tiles float64':>26}")
    for seed in (20, 21):
        compare_with_oracle("mixed", make_scene(seed, degree=3), make_camera(641, 479), make_pose())
    small, real = view.smaller(8), view.resampled(2000).shaken().gaussians
    compare_with_oracle("real", real, small.camera, small.T_world_cam)


def main(part: str) -> None:
    view = load_view()
    if part == "oracle":
        oracle_table(view)
        return
    if part == "memory":
        view = view.resampled(100_000)
        cost = measure(view.gradient(view.config()), view.gaussians, repeats=3)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(
            f"\n100,000 Gaussians at 640x480, forward + backward: {cost.ms:.1f} ms, peak memory {peak:.0f} MB"
        )
        return
    rates = Rates.measured()
    if part == "scene":
        for factor in (1, 2):
            scene_table(view.smaller(factor), rates)
    elif part == "growth":
        sizes = [view.smaller(4), view.smaller(2), view, view.larger(2)]
        growth_table([view.resampled(count) for count in COUNTS] + sizes, rates)
    else:
        raise InputError(f"Unknown part {part!r}; there are {', '.join(PARTS)}.")


PARTS = ("scene", "growth", "memory", "oracle")

if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(sys.argv[1])
    else:
        for part in PARTS:
            subprocess.run([sys.executable, "-m", "benchmarks.splatting", part], check=True)
