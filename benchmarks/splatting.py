"""The renderer's times beside the floors of the same machine: `python -m benchmarks.splatting`.

One process, medians of warm calls, on `data/bench/splat_scene_50k.npz` (50,000 Gaussians of one real
frame), found through SFGS_DATA or at ../shared. The floor of a time is what its pixel evaluations would
take at the rates of `exp` and of a matrix product measured in the same run.
"""

import os
import resource
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jax import Array

from sfgs_jax.geometry import Camera, InputError, se3
from sfgs_jax.splatting import Gaussians, RenderConfig, l1, pair_capacity, project, render, rgb_to_sh, ssim
from sfgs_jax.splatting.binning import bin_into_tiles
from sfgs_jax.splatting.compositing import composite

REPEATS = 15


def load_scene() -> tuple[Gaussians, Camera, jaxlie.SE3, Array]:
    """Gaussians, camera, pose and target image; pixel centres brought to integer coordinates."""
    root = Path(os.environ.get("SFGS_DATA", Path(__file__).parents[2] / "shared"))
    path = root / "data" / "bench" / "splat_scene_50k.npz"
    if not path.is_file():
        raise InputError(f"No benchmark scene at {path}; set SFGS_DATA to the folder that holds data/.")
    data = np.load(path)
    n, K = len(data["means"]), data["K"]
    opacities = jnp.asarray(data["opacities"])
    gaussians = Gaussians(
        means=jnp.asarray(data["means"]),
        quaternions=jnp.asarray(data["quats"]),
        log_scales=jnp.log(jnp.asarray(data["scales"])),
        opacity_logits=jnp.log(opacities / (1 - opacities)),
        sh=rgb_to_sh(jnp.asarray(data["colors"]))[:, None],
        valid=jnp.ones(n, bool),
    )
    width, height = int(data["width"]), int(data["height"])
    camera = Camera(K[0, 0], K[1, 1], K[0, 2] - 0.5, K[1, 2] - 0.5, width=width, height=height)
    T_world_cam = se3.from_matrix(np.linalg.inv(data["viewmat"].astype(np.float64)))
    return gaussians, camera, T_world_cam, jnp.asarray(data["target"])


def measure(function: Callable, *args) -> tuple[float, float, int]:
    """Median milliseconds of a warm call, seconds to compile, bytes of scratch memory."""
    start = time.perf_counter()
    program = jax.jit(function).lower(*args).compile()
    compiled = time.perf_counter() - start
    analysis = program.memory_analysis()
    times = []
    for repeat in range(REPEATS + 2):
        start = time.perf_counter()
        jax.block_until_ready(program(*args))
        if repeat >= 2:
            times.append(time.perf_counter() - start)
    return 1e3 * statistics.median(times), compiled, analysis.temp_size_in_bytes if analysis else 0


def rates() -> tuple[float, float]:
    """Exponentials per second, and floating-point operations per second of a matrix product."""
    exponents, matrix = jnp.zeros((16_384, 1024)), jnp.ones((1536, 1536))
    exp_ms = measure(lambda x: jnp.sum(jnp.exp(x), axis=-1), exponents)[0]
    matmul_ms = measure(lambda x: x @ x, matrix)[0]
    return exponents.size / exp_ms * 1e3, 2 * 1536**3 / matmul_ms * 1e3


def run_size(factor: int, exp_rate: float, flop_rate: float) -> None:
    gaussians, camera, T_world_cam, target = load_scene()
    camera = camera.downscaled(factor)
    target = target.reshape(camera.height, factor, camera.width, factor, 3).mean((1, 3))
    config = RenderConfig(pair_capacity=pair_capacity(gaussians, camera, T_world_cam))

    def forward(gaussians: Gaussians):
        return render(gaussians, camera, T_world_cam, config=config)

    def loss(gaussians: Gaussians) -> Array:
        out = forward(gaussians)
        return l1(out.rgb, target) + jnp.mean(out.accumulated_depth)

    def bin_tiles(projected):
        return bin_into_tiles(
            projected,
            width=camera.width,
            height=camera.height,
            tile_size=config.tile_size,
            pair_capacity=config.pair_capacity,
            near=config.near,
            far=config.far,
        )

    projected, colours = jax.jit(lambda g: project(g, camera, T_world_cam))(gaussians)
    lists = jax.jit(bin_tiles)(projected)
    columns = [projected.centres, projected.whitening, projected.log_opacities[:, None], colours]
    table = jnp.concatenate([*columns, projected.depths[:, None]], axis=1)

    def draw(table: Array) -> Array:
        return composite(table, lists, camera.width, camera.height, config.tile_size)

    pairs = int(jnp.sum(lists.counts))
    evaluations = pairs * config.tile_size**2
    # Backward, one more exponential and the ten sums of a pair's gradient, two operations each.
    floor = 1e3 * evaluations / exp_rate
    floor_gradient = 2 * floor + 1e3 * 20 * evaluations / flop_rate

    print(f"\n{camera.width}x{camera.height}: {pairs} pairs, room for {config.pair_capacity}")
    print(f"{'':34}{'ms':>9}{'floor':>9}{'ratio':>8}{'compile s':>11}{'scratch MB':>12}")
    rows = [
        ("forward", forward, gaussians, floor),
        ("forward + backward", jax.value_and_grad(loss, allow_int=True), gaussians, floor_gradient),
        ("  project", lambda g: project(g, camera, T_world_cam), gaussians, None),
        ("  bin into tiles", bin_tiles, projected, None),
        ("  composite", draw, table, floor),
        ("  composite + gradient", jax.grad(lambda t: jnp.mean(draw(t))), table, floor_gradient),
        ("SSIM + gradient", jax.value_and_grad(lambda image: ssim(image, target)), target[::-1], None),
    ]
    for name, function, argument, bound in rows:
        ms, compiled, scratch = measure(function, argument)
        limits = f"{bound:9.1f}{ms / bound:8.1f}" if bound else " " * 17
        print(f"{name:34}{ms:9.1f}{limits}{compiled:11.1f}{scratch / 1e6:12.1f}")


def main() -> None:
    exp_rate, flop_rate = rates()
    print(f"jax {jax.__version__} on {jax.devices()[0].platform}, {os.cpu_count()} cores")
    print(f"exp {exp_rate / 1e9:.2f} G/s, matrix product {flop_rate / 1e9:.0f} GFLOP/s")
    for factor in (1, 2):
        run_size(factor, exp_rate, flop_rate)
    print(f"\npeak memory of the process: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


if __name__ == "__main__":
    main()
