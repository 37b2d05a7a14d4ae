"""Optimise a pose graph with loop closures.

A camera walks a circle twice. Its odometry drifts; on the second lap each pose is also measured against the
pose of the lap before. `solve` finds the poses that agree best with all measurements, and
`marginal_covariances` says how certain they are. (`solve_implicit` is the same solve with a gradient.)

    python examples/02_pose_graph.py [PICTURE.svg]
"""

import sys

import jax.numpy as jnp
import jaxlie
import numpy as np

from sfgs_jax import factor_graph
from sfgs_jax.geometry import se3

LAP = 40
SIGMAS = np.array([0.02, 0.02, 0.02, 0.01, 0.01, 0.01])  # of a measurement: metres, then radians


def circle(count: int) -> jaxlie.SE3:
    """Poses on a circle of 2 m radius, each turned about the vertical from the one before."""
    step = jnp.array([2 * np.pi * 2.0 / LAP, 0.0, 0.0, 0.0, -2 * np.pi / LAP, 0.0])
    return se3.exp(jnp.arange(count, dtype=jnp.float32)[:, None] * step[None])


def main(picture: str | None = None) -> dict[str, float]:
    count = 2 * LAP
    truth = circle(count)
    chain = np.stack([np.arange(count - 1), np.arange(1, count)], axis=1)
    loops = np.stack([np.arange(LAP), np.arange(LAP, count)], axis=1)
    rng = np.random.default_rng(0)

    def measured(pairs):
        T_a, T_b = (jaxlie.SE3(truth.wxyz_xyz[pairs[:, i]]) for i in range(2))
        noise = se3.exp(jnp.asarray(rng.normal(scale=SIGMAS, size=(len(pairs), 6)), jnp.float32))
        return se3.compose(se3.compose(se3.inverse(T_a), T_b), noise)

    information = jnp.diag(jnp.asarray(SIGMAS**-2, jnp.float32))
    odometry = factor_graph.RelativePose(chain, measured(chain), information)
    closures = factor_graph.RelativePose(
        loops, measured(loops), information, kernel="dynamic_covariance_scaling", kernel_width=3.0
    )
    start = factor_graph.spanning_tree_start(odometry, count)
    free = np.arange(count) > 0  # the first pose holds the others in place
    graph = factor_graph.FactorGraph([odometry, closures], num_poses=count, free_poses=free)
    solution = factor_graph.solve(graph, start)

    def errors_cm(values):
        return 100 * jnp.linalg.norm(values.poses.wxyz_xyz[:, 4:] - truth.wxyz_xyz[:, 4:], axis=1)

    before, after = (float(jnp.sqrt(jnp.mean(errors_cm(v) ** 2))) for v in (start, solution.values))
    far = np.array([LAP // 2])  # half a lap from the fixed pose
    covariance = factor_graph.marginal_covariances(graph, solution.values, poses=far).poses[0]
    sigma_cm = 100 * float(jnp.sqrt(jnp.max(jnp.linalg.eigvalsh(covariance[:3, :3]))))
    off_cm = float(errors_cm(solution.values)[LAP // 2])
    print(f"{solution.status} after {int(solution.iterations)} iterations")
    print(f"error {before:.1f} cm by odometry, {after:.1f} cm with the loops")
    print(f"half a lap away: {off_cm:.1f} cm off, where its covariance says {sigma_cm:.1f} cm (one sigma)")
    if picture is not None:
        factor_graph.plot_graph(graph, start, solution.values, picture)
    return {
        "odometry_cm": before,
        "solved_cm": after,
        "converged": float(solution.status == factor_graph.Status.CONVERGED),
        "off_cm": off_cm,
        "sigma_cm": sigma_cm,
    }


if __name__ == "__main__":
    main(picture=sys.argv[1] if len(sys.argv) > 1 else None)
