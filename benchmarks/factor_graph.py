"""Factor graphs: bundle adjustment and pose graphs beside GTSAM, growth, false loop closures.

    python -m benchmarks.factor_graph [PART ...] [--poses 25 50 ...] [--seeds 0 1 ...] [--noise 1]

Parts: bundle, sphere, torus, garage, growth, false_loops; all by default. Reads data/bench/ba_problem.npz
below SFGS_DATA, else ../shared; GTSAM, the peer, brings sphere2500; torus and garage are made here, and read
from the g2o file that they are written to. Times are medians after warm-up, from values to values; those of
pose graphs begin at the odometry and hold the start found from there. Laying a graph out is timed apart: it
is done once, while GTSAM orders its variables in each solve. Costs are what GTSAM computes in float64 from
the values either ends with; "above" is ours over GTSAM's, less one; "apart" the largest distance between
both's poses and landmarks, over the extent of the scene.
Compare rows of one run: absolute times depend on the machine.
"""

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks import pose_graphs
from benchmarks.pose_graphs import motions
from sfgs_jax.arrays import InputError
from sfgs_jax.factor_graph import (
    Capacities,
    Factor,
    FactorGraph,
    PoseGraph,
    PosePrior,
    RelativePose,
    Reprojection,
    Solution,
    SolverConfig,
    Values,
    chordal_start,
    consistent_loops,
    read_g2o,
    solve,
    spanning_tree_start,
    write_g2o,
)
from sfgs_jax.geometry import Camera, Kernel, se3

SWAPPED = [3, 4, 5, 0, 1, 2]
"""GTSAM's tangents are rotation first."""


def bundle_adjustment() -> dict[str, np.ndarray]:
    root = Path(os.environ.get("SFGS_DATA", Path(__file__).parents[2] / "shared"))
    path = root / "data" / "bench" / "ba_problem.npz"
    if not path.is_file():
        raise InputError(f"No {path}; set SFGS_DATA to the folder that holds data/.")
    with np.load(path) as file:
        return {name: file[name] for name in file.files}


def weight(translation: float, rotation: float) -> jax.Array:
    """Information of standard deviations."""
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
            weight(float(p["prior_sigma_trans"]), float(p["prior_sigma_rot"])),
        ),
        RelativePose(ends, measured, weight(float(p["sigma_trans"]), float(p["sigma_rot"]))),
        Reprojection(
            p["obs_cam"],
            p["obs_lm"],
            jnp.asarray(p["obs_uv"], jnp.float32),
            camera,
            sigma=float(p["sigma_px"]),
        ),
    ]
    graph = FactorGraph(factors, num_poses=len(p["poses_init"]), num_landmarks=len(p["landmarks_init"]))
    return graph, Values(motions(p["poses_init"]), jnp.asarray(p["landmarks_init"], jnp.float32))


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


def sphere2500() -> PoseGraph:
    """The public file."""
    import gtsam  # pyright: ignore[reportMissingImports]

    peer, _ = gtsam.load3D(gtsam.findExampleDataFile("sphere2500.txt"))
    edges: list[Any] = [peer.at(i) for i in range(peer.size())]
    information = np.array([edge.noiseModel().information()[np.ix_(SWAPPED, SWAPPED)] for edge in edges])
    measured = RelativePose(
        np.array([edge.keys() for edge in edges]),
        motions(np.array([edge.measured().matrix() for edge in edges])),
        jnp.asarray(information, jnp.float32),
    )
    numbers = np.arange(2500)
    return PoseGraph(spanning_tree_start(measured, 2500), measured, numbers, numbers == 0)


def through_a_file(graph: PoseGraph) -> PoseGraph:
    with tempfile.TemporaryDirectory() as folder:
        write_g2o(Path(folder) / "graph.g2o", graph)
        return read_g2o(Path(folder) / "graph.g2o")


def from_odometry(file: PoseGraph, capacities: Capacities | None) -> tuple[FactorGraph, Values, Any, Any]:
    """A pose graph and its odometry: ours and GTSAM's."""
    import gtsam  # pyright: ignore[reportMissingImports]

    edges, count = file.edges, len(file.vertices)
    values = spanning_tree_start(edges, count)
    peer = gtsam.NonlinearFactorGraph()
    measured = se3.to_matrices(edges.T_a_b)
    information = np.asarray(edges.matrices, np.float64)[:, SWAPPED][:, :, SWAPPED]
    for (a, b), T, matrix in zip(edges.poses, measured, information, strict=True):
        noise = gtsam.noiseModel.Gaussian.Information(matrix)
        peer.add(gtsam.BetweenFactorPose3(int(a), int(b), gtsam.Pose3(T), noise))
    peer.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(), gtsam.noiseModel.Isotropic.Sigma(6, 1e-4)))
    free = np.arange(count) > 0
    graph = FactorGraph([edges], num_poses=count, free_poses=free, capacities=capacities)
    return graph, values, peer, peer_values(values)


def corridor(poses: int) -> tuple[list[Factor], Values]:
    """Cameras in a row, 30 landmarks for each, every landmark seen by the cameras before which it lies."""
    rng = np.random.default_rng(0)
    truth = np.tile(np.eye(4), (poses, 1, 1))
    truth[:, 0, 3] = 0.3 * np.arange(poses)
    centre = np.repeat(np.arange(poses), 30)
    points = rng.uniform([-0.15, -0.8, 2], [0.15, 0.8, 4], (len(centre), 3))
    points[:, 0] += 0.3 * centre
    camera, landmark = centre[:, None] + np.arange(-6, 7), np.arange(len(centre))[:, None]
    local = points[:, None] - np.eye(3)[0] * 0.3 * camera[:, :, None]
    pixels = 500 * local[..., :2] / local[..., 2:] + np.array([320.0, 240.0])
    inside = np.all((pixels >= 0) & (pixels < [640, 480]), axis=2) & (camera >= 0) & (camera < poses)
    seen = pixels[inside] + rng.normal(size=(inside.sum(), 2))
    ends = np.stack([np.arange(poses - 1), np.arange(1, poses)], axis=1)
    step = motions(np.linalg.inv(truth[:1]) @ truth[1:2]).wxyz_xyz
    factors = [
        PosePrior([0], motions(truth[:1]), weight(0.01, 0.01)),
        RelativePose(ends, jaxlie.SE3(jnp.tile(step, (poses - 1, 1))), weight(0.02, 0.01)),
        Reprojection(
            camera[inside],
            np.broadcast_to(landmark, camera.shape)[inside],
            jnp.asarray(seen, jnp.float32),
            Camera(500.0, 500.0, 320.0, 240.0, width=640, height=480),
        ),
    ]
    noise = se3.exp(jnp.asarray(rng.normal(scale=0.02, size=(poses, 6)), jnp.float32))
    start = points + rng.normal(scale=0.05, size=points.shape)
    return factors, Values(se3.compose(motions(truth), noise), jnp.asarray(start, jnp.float32))


def false_loops(seeds: list[int]) -> Table:
    """Errors of the origins where 30 % of the loops are false, over that with the true ones alone.

    "kernel, none false" is the kernel's own: what it ends at without false loops. "check, kernel" starts from
    what the loops that agree lead to, and has all loops under the kernel.
    """
    table = Table(title="30 % of the loop closures false: error of the origins, over that with none")
    columns = (
        "world",
        "seed",
        "none, m",
        "no defence",
        "kernel",
        "kernel, none false",
        "check",
        "check, kernel",
        "kept true, false",
    )
    for column in columns:
        table.add_column(column, justify="left" if column == "world" else "right")
    robust: Kernel = "dynamic_covariance_scaling"
    for world in (pose_graphs.sphere, pose_graphs.lattice, pose_graphs.large_sphere):
        capacities = None
        for seed in seeds:
            rng = np.random.default_rng(seed)
            made = world(rng)
            file = pose_graphs.measured(made, rng)
            loops, false = pose_graphs.with_false_loops(file, rng, 0.3)
            kept = consistent_loops(loops, file.values)
            truth = (np.linalg.inv(made.truth[0]) @ made.truth)[:, :3, 3]
            everything = np.ones(len(false), bool)
            found = file.values
            errors = []
            trials: list[tuple[np.ndarray, Kernel, bool]] = [
                (~false, "none", False),
                (everything, "none", False),
                (everything, robust, False),
                (~false, robust, False),
                (kept, "none", False),
                (everything, robust, True),
            ]
            for valid, kernel, further in trials:
                graph = closed(file, loops, valid, kernel, capacities)
                capacities = graph.capacities
                start = found if further else file.values
                found = solve(graph, start, SolverConfig(max_iterations=100)).values
                apart = np.asarray(found.poses.wxyz_xyz[:, 4:]) - truth
                errors.append(float(np.sqrt(np.mean(np.sum(apart**2, axis=1)))))
            none, *others = errors
            ratios = [f"{error / none:.2f}" for error in others]
            shares = f"{kept[~false].mean():.0%}, {kept[false].mean():.0%}"
            table.add_row(world.__name__, str(seed), f"{none:.3f}", *ratios, shares)
    return table


def closed(
    file: PoseGraph, loops: RelativePose, valid: np.ndarray, kernel: Kernel, capacities: Capacities | None
) -> FactorGraph:
    """The odometry of a pose graph, and loops."""
    count, weights = len(file.vertices), file.edges.matrices[0]
    chain = slice(0, count - 1)
    odometry = RelativePose(file.edges.poses[chain], jaxlie.SE3(file.edges.T_a_b.wxyz_xyz[chain]), weights)
    closures = RelativePose(loops.poses, loops.T_a_b, weights, valid=valid, kernel=kernel, kernel_width=3.0)
    free = np.arange(count) > 0
    return FactorGraph([odometry, closures], num_poses=count, free_poses=free, capacities=capacities)


def median_ms(run: Callable[[], Any], repetitions: int) -> tuple[float, Any]:
    times, result = [], None
    for _ in range(repetitions):
        begin = time.perf_counter()
        result = jax.block_until_ready(run())
        times.append(time.perf_counter() - begin)
    return 1000 * float(np.median(times)), result


def peer_values(values: Values) -> Any:
    """Ours, as GTSAM holds them."""
    import gtsam  # pyright: ignore[reportMissingImports]

    X, L = gtsam.symbol_shorthand.X, gtsam.symbol_shorthand.L
    pose = X if len(values.landmarks) else int
    result = gtsam.Values()
    rows = np.asarray(values.poses.wxyz_xyz, np.float64)
    for i, row in enumerate(rows):
        wxyz = row[:4] / np.linalg.norm(row[:4])
        result.insert(pose(i), gtsam.Pose3(gtsam.Rot3.Quaternion(*wxyz), row[4:]))
    for i, point in enumerate(np.asarray(values.landmarks, np.float64)):
        result.insert(L(i), point)
    return result


def compare(name: str, problem: tuple[FactorGraph, Values, Any, Any], repetitions: tuple[int, int]) -> Table:
    """Ours beside GTSAM's Levenberg-Marquardt with its default settings, both from the same values."""
    import gtsam  # pyright: ignore[reportMissingImports]

    graph, values, peer, start = problem
    on_device = jax.tree.map(jnp.asarray, graph)
    config = SolverConfig(max_iterations=100)
    pose_graph = not graph.num_landmarks

    def from_start() -> Solution:
        return solve(on_device, chordal_start(on_device, values), config)

    def from_given() -> Solution:
        return solve(on_device, values, config)

    def peer_from(start: Any) -> tuple[Any, int]:
        optimizer = gtsam.LevenbergMarquardtOptimizer(peer, start, gtsam.LevenbergMarquardtParams())
        return optimizer.optimize(), optimizer.iterations()

    def peer_from_start() -> tuple[Any, int]:
        return peer_from(gtsam.InitializePose3.initialize(peer))

    table = Table(title=name)
    for column in ("solver", "ms", "cost", "above", "apart", "iterations"):
        table.add_column(column, justify="left" if column == "solver" else "right")
    peer_ms, (peer_optimum, iterations) = median_ms(lambda: peer_from(start), repetitions[1])
    theirs = peer.error(peer_optimum)
    trials = {"sfgs_jax, chordal_start": from_start, "sfgs_jax": from_given}
    for solver, run in trials.items() if pose_graph else [("sfgs_jax", from_given)]:
        jax.block_until_ready(run())
        ms, solution = median_ms(run, repetitions[0])
        ours = peer.error(peer_values(solution.values))
        above, apart = f"{ours / theirs - 1:+.1e}", f"{distance(peer_optimum, solution.values):.1e}"
        table.add_row(solver, f"{ms:.1f}", f"{ours:.3f}", above, apart, str(int(solution.iterations)))
    table.add_row("GTSAM LM", f"{peer_ms:.1f}", f"{theirs:.3f}", "", "", str(iterations))
    if pose_graph:
        ms, (optimum, iterations) = median_ms(peer_from_start, repetitions[1])
        table.add_row(
            "GTSAM InitializePose3, LM", f"{ms:.1f}", f"{peer.error(optimum):.3f}", "", "", str(iterations)
        )
        ms, _ = median_ms(lambda: relaid(graph), repetitions[1])
        table.caption = f"laying the graph out: {ms:.0f} ms"
    return table


def relaid(graph: FactorGraph) -> FactorGraph:
    """The same pose graph, laid out anew."""
    return FactorGraph(
        graph.factors, num_poses=graph.num_poses, free_poses=graph.free_poses, capacities=graph.capacities
    )


def distance(peer: Any, values: Values) -> float:
    """Largest distance of a pose's origin or a landmark from GTSAM's, over the extent of the scene."""
    import gtsam  # pyright: ignore[reportMissingImports]

    X, L = gtsam.symbol_shorthand.X, gtsam.symbol_shorthand.L
    origins, points = np.asarray(values.poses.wxyz_xyz[:, 4:]), np.asarray(values.landmarks)
    pose = X if len(points) else int
    theirs = [peer.atPose3(pose(i)).translation() for i in range(len(origins))]
    theirs += [peer.atPoint3(L(i)) for i in range(len(points))]
    apart = np.linalg.norm(np.concatenate([origins, points]) - np.array(theirs), axis=1)
    return float(apart.max() / np.ptp(np.array(theirs), axis=0).max())


def growth(sizes: list[int]) -> Table:
    table = Table(title="Growth, 30 landmarks for each pose")
    for column in ("poses", "observations", "solver", "lay out ms", "ms / iteration", "MB", "iterations"):
        table.add_column(column, justify="left" if column == "solver" else "right")
    for poses in sizes:
        factors, values = corridor(poses)
        begin = time.perf_counter()
        graph = FactorGraph(factors, num_poses=poses, num_landmarks=len(values.landmarks))
        layout = 1000 * (time.perf_counter() - begin)
        graph = jax.tree.map(jnp.asarray, graph)
        program = jax.jit(solve).lower(graph, values).compile()
        jax.block_until_ready(program(graph, values))
        ms, solution = median_ms(lambda: program(graph, values), 3)  # noqa: B023
        count = int(solution.iterations)
        memory = program.memory_analysis()
        assert memory is not None
        megabytes = (memory.temp_size_in_bytes + memory.argument_size_in_bytes) / 1e6
        table.add_row(
            str(poses),
            str(len(factors[2].valid)),
            graph.linear_solver,
            f"{layout:.0f}",
            f"{ms / count:.2f}",
            f"{megabytes:.1f}",
            str(count),
        )
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description="Benchmarks of the factor graph.")
    parts = ("bundle", "sphere", "torus", "garage", "growth", "false_loops")
    parser.add_argument(
        "parts", nargs="*", metavar="PART", help=f"which of {', '.join(parts)}; all by default"
    )
    parser.add_argument("--seeds", type=int, nargs="+", default=[0], help="of torus, garage, false_loops")
    parser.add_argument("--noise", type=float, default=1.0, help="of torus and garage, times theirs")
    parser.add_argument("--poses", type=int, nargs="+", default=[25, 50, 100, 200, 400, 800])
    arguments = parser.parse_args()
    chosen = arguments.parts or parts
    if unknown := set(chosen) - set(parts):
        parser.error(f"unknown parts: {', '.join(sorted(unknown))}")
    console = Console(width=110)
    if "bundle" in chosen:
        problem = bundle_adjustment()
        both = *our_bundle_adjustment(problem), *gtsam_bundle_adjustment(problem)
        console.print(compare("Bundle adjustment: 100 poses, 3000 landmarks", both, (15, 3)))
    if "sphere" in chosen:
        problem = from_odometry(sphere2500(), None)
        console.print(compare("sphere2500, from its odometry", problem, (5, 3)))
    for world in (pose_graphs.torus, pose_graphs.garage):
        capacities = None
        for seed in arguments.seeds if world.__name__ in chosen else ():
            rng = np.random.default_rng(seed)
            made = world(rng)
            noise = made.noise[0] * arguments.noise, made.noise[1] * arguments.noise
            file = through_a_file(pose_graphs.measured(replace(made, noise=noise), rng))
            title = f"{world.__name__} {seed}, {len(file.vertices)} poses, {len(file.edges.poses)} edges"
            problem = from_odometry(file, capacities)
            capacities = problem[0].capacities
            console.print(compare(f"{title}, noise x {arguments.noise}, from its odometry", problem, (5, 3)))
    if "growth" in chosen:
        console.print(growth(arguments.poses))
    if "false_loops" in chosen:
        console.print(false_loops(arguments.seeds))


if __name__ == "__main__":
    main()
