"""Success rate of registration from starts perturbed by up to 10 cm and 10 degrees, beside small_gicp.

    python -m benchmarks.gicp_starts [--first FRAME] [word ...].

Words select the columns that contain one of them, such as depth, points or small_gicp. The frames are every
40th from the first, 10 if not given; other frames have other starts too.

Registers RedKitchen depth images one frame apart, read below SFGS_DATA, else ../shared. A start is the given
motion times a random one with the length and angle of its row. A success ends within 2 cm and 1 degree of
the given motion. Both allow for the given poses, which are good to about a centimetre.
"""

import argparse
import importlib.util
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.gicp import CAMERA, data_root, load, motion_error
from sfgs_jax.geometry import se3
from sfgs_jax.gicp import align, prepare, prepare_points

TRIALS = 6
PERTURBATIONS = ((2.0, 2.0), (5.0, 5.0), (10.0, 5.0), (5.0, 10.0), (10.0, 10.0))

Aligner = Callable[[np.ndarray], np.ndarray]


def points_of(depth: np.ndarray, stride: int = 2) -> np.ndarray:
    v, u = np.mgrid[: depth.shape[0] : stride, : depth.shape[1] : stride]
    z = depth[::stride, ::stride].astype(np.float64)
    return np.stack([(u - 320.0) / 585.0 * z, (v - 240.0) / 585.0 * z, z], -1)[z > 0]


def organised(target: np.ndarray, source: np.ndarray) -> Aligner:
    clouds = prepare(source, CAMERA), prepare(target, CAMERA)
    return lambda start: np.asarray(se3.matrix(align(*clouds, se3.from_matrix(start)).T_target_source))


def unorganised(target: np.ndarray, source: np.ndarray) -> Aligner:
    clouds = prepare_points(points_of(source)), prepare_points(points_of(target))
    return lambda start: np.asarray(se3.matrix(align(*clouds, se3.from_matrix(start)).T_target_source))


def small_gicp(max_distance: float) -> Callable[[np.ndarray, np.ndarray], Aligner]:
    import small_gicp as peer  # pyright: ignore[reportMissingImports]

    def build(target: np.ndarray, source: np.ndarray) -> Aligner:
        cloud, tree = peer.preprocess_points(points_of(target), downsampling_resolution=0.05, num_threads=2)
        moving, _ = peer.preprocess_points(points_of(source), downsampling_resolution=0.05, num_threads=2)
        return lambda start: (
            peer.align(
                cloud,
                moving,
                tree,
                init_T_target_source=start,
                registration_type="GICP",
                max_correspondence_distance=max_distance,
                num_threads=2,
            ).T_target_source
        )

    return build


def perturbation(rng: np.random.Generator, centimetres: float, degrees: float) -> np.ndarray:
    directions = rng.normal(size=(2, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    tangent = np.concatenate([centimetres / 100 * directions[0], np.radians(degrees) * directions[1]])
    return np.asarray(se3.matrix(se3.exp(jnp.asarray(tangent, jnp.float32))), np.float64)


def main() -> None:
    parser = argparse.ArgumentParser(description="Successes from perturbed starts.")
    parser.add_argument("words", nargs="*", metavar="word")
    parser.add_argument("--first", type=int, default=10)
    arguments = parser.parse_args()
    starts = range(arguments.first, 570, 40)
    folder = data_root() / "data" / "7scenes" / "redkitchen"
    builders = {"sfgs_jax depth images": organised, "sfgs_jax points": unorganised}
    if importlib.util.find_spec("small_gicp"):
        builders |= {f"small_gicp, {100 * d:.0f} cm": small_gicp(d) for d in (0.1, 0.3, 1.0)}
    words = arguments.words or [""]
    builders = {name: b for name, b in builders.items() if any(word in name for word in words)}
    successes = {name: np.zeros(len(PERTURBATIONS)) for name in builders}
    for start in starts:
        (target, T_world_target), (source, T_world_source) = load(folder, start), load(folder, start + 1)
        given = np.linalg.inv(T_world_target) @ T_world_source
        for name, build in builders.items():
            aligner, rng = build(target, source), np.random.default_rng(start)
            for row, (centimetres, degrees) in enumerate(PERTURBATIONS):
                for _ in range(TRIALS):
                    found = aligner(given @ perturbation(rng, centimetres, degrees))
                    error = motion_error(found.astype(np.float64), given)
                    successes[name][row] += error[0] < 2 and error[1] < 1
    table = Table(title=f"Successes of {TRIALS * len(starts)} from perturbed starts, %")
    table.add_column("start off by")
    for name in builders:
        table.add_column(name, justify="right")
    for row, (centimetres, degrees) in enumerate(PERTURBATIONS):
        shares = [f"{100 * s[row] / (TRIALS * len(starts)):.0f}" for s in successes.values()]
        table.add_row(f"{centimetres:.0f} cm, {degrees:.0f}°", *shares)
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
