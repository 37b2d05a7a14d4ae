"""Factor graphs: bundle adjustment and a public pose graph, beside GTSAM where that is installed.

    python -m benchmarks.factor_graph

Reads data/bench/ba_problem.npz below SFGS_DATA, else ../shared; sphere2500 comes with GTSAM. Times are
medians after warm-up, from values to values. Compare rows of one run: absolute times depend on the machine.
"""

import importlib.util
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from rich.console import Console
from rich.table import Table

from sfgs_jax.factor_graph import (
    FactorGraph,
    PosePrior,
    RelativePose,
    Reprojection,
    SolverConfig,
    Values,
    solve,
)
from sfgs_jax.geometry import Camera, InputError
from sfgs_jax.geometry.rotations import quaternions_from_rotations


def motions(matrices: np.ndarray) -> jaxlie.SE3:
    wxyz = quaternions_from_rotations(matrices[:, :3, :3])
    return jaxlie.SE3(jnp.asarray(np.concatenate([wxyz, matrices[:, :3, 3]], axis=1), jnp.float32))


def bundle_adjustment() -> dict[str, np.ndarray]:
    root = Path(os.environ.get("SFGS_DATA", Path(__file__).parents[2] / "shared"))
    path = root / "data" / "bench" / "ba_problem.npz"
    if not path.is_file():
        raise InputError(f"No {path}; set SFGS_DATA to the folder that holds data/.")
    with np.load(path) as file:
        return {name: file[name] for name in file.files}


def precision(translation: float, rotation: float) -> jax.Array:
    return jnp.asarray(np.diag([translation**-2] * 3 + [rotation**-2] * 3), jnp.float32)


def our_bundle_adjustment(p: dict[str, np.ndarray]) -> tuple[FactorGraph, Values]:
    K = p["K"]
    camera = Camera(K[0, 0], K[1, 1], K[0, 2], K[1, 2], width=640, height=480)
    ends = np.concatenate([p["odo_ij"], p["loop_ij"]])
    measured = motions(np.concatenate([p["odo_T"], p["loop_T"]]))
    factors = [
        PosePrior(
            [0],
            motions(p["poses_gt"][:1]),
            precision(float(p["prior_sigma_trans"]), float(p["prior_sigma_rot"])),
        ),
        RelativePose(ends, measured, precision(float(p["sigma_trans"]), float(p["sigma_rot"]))),
        Reprojection(
            p["obs_cam"],
            p["obs_lm"],
            jnp.asarray(p["obs_uv"], jnp.float32),
            camera,
            sigma=float(p["sigma_px"]),
        ),
    ]
    graph = FactorGraph(factors, num_poses=len(p["poses_init"]), num_landmarks=len(p["landmarks_init"]))
    values = Values(motions(p["poses_init"]), jnp.asarray(p["landmarks_init"], jnp.float32))
    return jax.tree.map(jnp.asarray, graph), values


def gtsam_bundle_adjustment(p: dict[str, np.ndarray]) -> tuple[Any, Any]:
    import gtsam  # pyright: ignore[reportMissingImports]

    def noise(rotation: float, translation: float) -> Any:
        return gtsam.noiseModel.Diagonal.Sigmas(np.array([rotation] * 3 + [translation] * 3))

    K, X, L = p["K"], gtsam.symbol_shorthand.X, gtsam.symbol_shorthand.L
    calibration = gtsam.Cal3_S2(K[0, 0], K[1, 1], 0.0, K[0, 2], K[1, 2])
    graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    prior = noise(float(p["prior_sigma_rot"]), float(p["prior_sigma_trans"]))
    graph.add(gtsam.PriorFactorPose3(X(0), gtsam.Pose3(p["poses_gt"][0]), prior))
    between = noise(float(p["sigma_rot"]), float(p["sigma_trans"]))
    for kind in ("odo", "loop"):
        for (a, b), T in zip(p[f"{kind}_ij"], p[f"{kind}_T"], strict=True):
            graph.add(gtsam.BetweenFactorPose3(X(int(a)), X(int(b)), gtsam.Pose3(T), between))
    pixel = gtsam.noiseModel.Isotropic.Sigma(2, float(p["sigma_px"]))
    for uv, camera, landmark in zip(p["obs_uv"], p["obs_cam"], p["obs_lm"], strict=True):
        graph.add(
            gtsam.GenericProjectionFactorCal3_S2(uv, pixel, X(int(camera)), L(int(landmark)), calibration)
        )
    for i, T in enumerate(p["poses_init"]):
        start.insert(X(i), gtsam.Pose3(T))
    for i, point in enumerate(p["landmarks_init"]):
        start.insert(L(i), point)
    return graph, start


def sphere() -> tuple[FactorGraph, Values, Any, Any]:
    """The public sphere2500, from its odometry: ours and GTSAM's."""
    import gtsam  # pyright: ignore[reportMissingImports]

    peer, _ = gtsam.load3D(gtsam.findExampleDataFile("sphere2500.txt"))
    edges = [peer.at(i) for i in range(peer.size())]
    ends = np.array([edge.keys() for edge in edges])
    measured = np.array([edge.measured().matrix() for edge in edges])
    # GTSAM's tangents are rotation first.
    order = [3, 4, 5, 0, 1, 2]
    information = np.array([edge.noiseModel().information()[np.ix_(order, order)] for edge in edges])
    steps = {a: T for (a, b), T in zip(ends, measured, strict=True) if b == a + 1}
    poses = [np.eye(4)]
    for a in range(ends.max()):
        poses.append(poses[-1] @ steps[a])
    peer.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(), gtsam.noiseModel.Isotropic.Sigma(6, 1e-4)))
    start = gtsam.Values()
    for i, T in enumerate(poses):
        start.insert(i, gtsam.Pose3(T))
    factors = [
        PosePrior([0], motions(np.eye(4)[None]), precision(1e-4, 1e-4)),
        RelativePose(ends, motions(measured), jnp.asarray(information, jnp.float32)),
    ]
    graph = FactorGraph(factors, num_poses=len(poses))
    return jax.tree.map(jnp.asarray, graph), Values(motions(np.array(poses))), peer, start


def median_ms(run: Callable[[], Any], repetitions: int) -> tuple[float, Any]:
    times, result = [], None
    for _ in range(repetitions):
        begin = time.perf_counter()
        result = jax.block_until_ready(run())
        times.append(time.perf_counter() - begin)
    return 1000 * float(np.median(times)), result


def add_ours(
    table: Table, name: str, graph: FactorGraph, values: Values, config: SolverConfig, repetitions: int
) -> None:
    jax.block_until_ready(solve(graph, values, config))
    ms, solution = median_ms(lambda: solve(graph, values, config), repetitions)
    table.add_row(name, "sfgs_jax", f"{ms:.1f}", f"{float(solution.cost):.3f}", str(int(solution.iterations)))


def add_gtsam(table: Table, name: str, graph: Any, start: Any, repetitions: int) -> None:
    import gtsam  # pyright: ignore[reportMissingImports]

    def run() -> tuple[float, int]:
        optimizer = gtsam.LevenbergMarquardtOptimizer(graph, start, gtsam.LevenbergMarquardtParams())
        return graph.error(optimizer.optimize()), optimizer.iterations()

    ms, (cost, iterations) = median_ms(run, repetitions)
    table.add_row(name, "GTSAM LM", f"{ms:.1f}", f"{cost:.3f}", str(iterations))


def main() -> None:
    table = Table(title="Factor graphs")
    for column in ("", "solver", "ms", "cost", "iterations"):
        table.add_column(column, justify="left" if column in ("", "solver") else "right")
    problem = bundle_adjustment()
    name = "bundle adjustment, 100 poses"
    add_ours(table, name, *our_bundle_adjustment(problem), SolverConfig(), 15)
    if importlib.util.find_spec("gtsam"):
        add_gtsam(table, name, *gtsam_bundle_adjustment(problem), 3)
        graph, values, peer, start = sphere()
        add_ours(table, "sphere2500", graph, values, SolverConfig(max_iterations=60), 3)
        add_gtsam(table, "sphere2500", peer, start, 1)
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
