"""Small graphs with known answers."""

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np

from sfgs_jax.factor_graph import FactorGraph, PosePrior, RelativePose, Reprojection, Values
from sfgs_jax.geometry import Camera, quaternions_from_rotations, se3

CAMERA = Camera(500.0, 510.0, 320.0, 240.0, width=640, height=480)


# One program for each instead of one for each operation.
exp, compose, inverse = jax.jit(se3.exp), jax.jit(se3.compose), jax.jit(se3.inverse)
project = jax.jit(lambda camera, points: camera.project(points))


def dtype():
    return jnp.result_type(float)


def random_poses(rng, n: int, scale: float = 0.3) -> jaxlie.SE3:
    return exp(jnp.asarray(rng.normal(scale=scale, size=(n, 6)), dtype()))


def perturb(poses: jaxlie.SE3, rng, scale: float) -> jaxlie.SE3:
    noise = rng.normal(scale=scale, size=(poses.wxyz_xyz.shape[0], 6))
    return compose(poses, exp(jnp.asarray(noise, dtype())))


def between(poses: jaxlie.SE3, ends) -> jaxlie.SE3:
    a, b = (jaxlie.SE3(poses.wxyz_xyz[np.asarray(ends)[:, i]]) for i in range(2))
    return compose(inverse(a), b)


def poses_of(matrices: np.ndarray) -> jaxlie.SE3:
    """Poses of matrices (N, 4, 4), made on the host: there no number of poses needs a program of its own."""
    wxyz = quaternions_from_rotations(matrices[:, :3, :3])
    return jaxlie.SE3(jnp.asarray(np.concatenate([wxyz, matrices[:, :3, 3]], axis=1), dtype()))


def eye(*diagonal: float):
    return jnp.asarray(np.diag(np.repeat(diagonal, 3)), dtype())


def blocks_of_ring(graph: FactorGraph) -> tuple[PosePrior, RelativePose]:
    """The factors of a `ring`."""
    prior, edges = graph.factors
    assert isinstance(prior, PosePrior)
    assert isinstance(edges, RelativePose)
    return prior, edges


def blocks_of_bundle(graph: FactorGraph) -> tuple[PosePrior, RelativePose, Reprojection]:
    """The factors of a `bundle`."""
    prior, chain, seen = graph.factors
    assert isinstance(prior, PosePrior)
    assert isinstance(chain, RelativePose)
    assert isinstance(seen, Reprojection)
    return prior, chain, seen


def bundle(rng, poses: int = 6, landmarks: int = 40, noise: float = 0.5, share: float = 0.7, **options):
    """A graph of cameras in a row that see a share of the points before them, its start and its truth."""
    tangents = np.zeros((poses, 6))
    tangents[:, 0] = 0.2 * np.arange(poses)
    tangents[:, 3:] = rng.normal(scale=0.03, size=(poses, 3))
    truth = exp(jnp.asarray(tangents, dtype()))
    points = rng.uniform([-1.5, -1, 2], [2.5, 1, 5], (landmarks, 3))
    camera, landmark = (x.reshape(-1) for x in np.mgrid[:poses, :landmarks])
    seen = rng.uniform(size=len(camera)) < share
    camera, landmark = camera[seen], landmark[seen]
    matrices = np.linalg.inv(se3.to_matrices(truth))[camera]
    local = np.einsum("nij,nj->ni", matrices[:, :3, :3], points[landmark]) + matrices[:, :3, 3]
    camera_of_type = jax.tree.map(lambda x: x.astype(dtype()), CAMERA)
    pixels = np.asarray(project(camera_of_type, jnp.asarray(local, dtype())))
    pixels = pixels + rng.normal(scale=noise, size=pixels.shape)
    ends = np.stack([np.arange(poses - 1), np.arange(1, poses)], axis=1)
    factors = [
        PosePrior([0], jaxlie.SE3(truth.wxyz_xyz[:1]), eye(1e4, 1e4)),
        RelativePose(ends, perturb(between(truth, ends), rng, 0.002), eye(1e4, 1e4)),
        Reprojection(camera, landmark, jnp.asarray(pixels, dtype()), CAMERA),
    ]
    start = Values(
        perturb(truth, rng, 0.02), jnp.asarray(points + rng.normal(scale=0.05, size=points.shape), dtype())
    )
    graph = FactorGraph(factors, num_poses=poses, num_landmarks=landmarks, **options)
    return graph, start, Values(truth, jnp.asarray(points, dtype()))


def ring(rng, n: int = 20, noise: float = 0.01, loops: int = 6, **options):
    """A pose graph round a circle, from its odometry."""
    angle = 2 * np.pi * np.arange(n) / n
    matrices = np.tile(np.eye(4), (n, 1, 1))
    matrices[:, 0, 0] = matrices[:, 1, 1] = np.cos(angle)
    matrices[:, 1, 0], matrices[:, 0, 1] = np.sin(angle), -np.sin(angle)
    matrices[:, :2, 3] = 2 * np.stack([np.sin(angle), -np.cos(angle)], axis=1)
    truth = poses_of(matrices)
    chain = np.stack([np.arange(n - 1), np.arange(1, n)], axis=1)
    far = np.stack([np.arange(loops), n - 1 - np.arange(loops)], axis=1)
    ends = np.concatenate([chain, far])
    measured = perturb(between(truth, ends), rng, noise)
    information = eye(noise**-2, noise**-2)
    start = [matrices[0]]
    for step in se3.matrices_of(np.asarray(measured.wxyz_xyz)[: n - 1]):
        start.append(start[-1] @ step)
    factors = [
        PosePrior([0], jaxlie.SE3(truth.wxyz_xyz[:1]), eye(1e6, 1e6)),
        RelativePose(ends, measured, information),
    ]
    return FactorGraph(factors, num_poses=n, **options), Values(poses_of(np.stack(start))), Values(truth)
