"""Worlds to drive through, and the pose graphs that are measured there.

The torus and the garage stand in for public files that don't come with a package: as many poses and edges,
the same kind of path and of loops, similar noise and information.
"""

from dataclasses import dataclass

import jax.numpy as jnp
import jaxlie
import numpy as np

from sfgs_jax.factor_graph import PoseGraph, RelativePose, spanning_tree_start
from sfgs_jax.geometry import quaternions_from_rotations, rotations_from_quaternions


@dataclass(frozen=True)
class World:
    """Poses driven through, and pairs of them that see each other."""

    truth: np.ndarray
    """(P, 4, 4) T_world_pose, in order of time."""

    loops: np.ndarray
    """(N, 2) pairs that are not neighbours in time."""

    noise: tuple[float, float]
    """Standard deviations, metres and radians."""

    information: tuple[float, float]
    """What is claimed of them: 1 / m² and 1 / rad²."""


def motions(matrices: np.ndarray) -> jaxlie.SE3:
    wxyz = quaternions_from_rotations(matrices[:, :3, :3])
    return jaxlie.SE3(jnp.asarray(np.concatenate([wxyz, matrices[:, :3, 3]], axis=1), jnp.float32))


def facing(positions: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Poses along a path that look where it leads."""
    ahead = np.gradient(positions, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    left = np.cross(up, ahead)
    left /= np.linalg.norm(left, axis=1, keepdims=True)
    matrices = np.tile(np.eye(4), (len(positions), 1, 1))
    matrices[:, :3] = np.stack([ahead, left, np.cross(ahead, left), positions], axis=2)
    return matrices


def some(rng: np.random.Generator, pairs: np.ndarray, count: int) -> np.ndarray:
    return pairs[np.sort(rng.permutation(len(pairs))[:count])]


def near(positions: np.ndarray, metres: float, apart: int) -> np.ndarray:
    """Pairs of poses near each other in space, but not in time."""
    from scipy.spatial import KDTree

    pairs = KDTree(positions).query_pairs(metres, output_type="ndarray")
    pairs = np.sort(pairs, axis=1)
    return pairs[pairs[:, 1] - pairs[:, 0] > apart]


def torus(rng: np.random.Generator) -> World:
    """After torus3D: 5000 poses wound round a torus, 9048 edges, strong noise."""
    steps = np.arange(5000)
    small, large = 2 * np.pi * steps / 50, 2 * np.pi * steps / 5000
    out = np.stack([np.cos(large), np.sin(large), np.zeros(5000)], axis=1)
    normal = np.cos(small)[:, None] * out + np.sin(small)[:, None] * np.eye(3)[2]
    turns = np.stack([steps[:-50], steps[50:]], axis=1)
    truth = facing(16 * out + 8 * normal, normal)
    return World(truth, some(rng, turns, 9048 - 4999), (0.1, 0.1), (100.0, 100.0))


def garage(rng: np.random.Generator) -> World:
    """After parking-garage: 1661 poses, 6275 edges, far more exact than their information claims."""
    angle = np.linspace(0, 12 * np.pi, 1661)
    radius = 15 + 5 * np.cos(2 * angle) + 2 * np.cos(angle / 3)
    positions = np.stack(
        [2 * radius * np.cos(angle), radius * np.sin(angle), 3 * (angle // (4 * np.pi))], axis=1
    )
    positions[:, 2] = np.convolve(np.pad(positions[:, 2], 40, "edge"), np.full(81, 1 / 81), "valid")
    truth = facing(positions, np.eye(3)[2])
    return World(truth, some(rng, near(positions, 8.0, 50), 6275 - 1660), (0.02, 0.003), (1.0, 4.0))


def lattice(rng: np.random.Generator) -> World:
    """125 poses to and fro through a cube of streets, looking anywhere, 40 loops between neighbours."""
    n = 5
    z, y, x = np.mgrid[:n, :n, :n].reshape(3, -1)
    y = np.where(z % 2 == 0, y, n - 1 - y)
    x = np.where((np.arange(n**3) // n) % 2 == 0, x, n - 1 - x)
    positions = np.stack([x, y, z], axis=1).astype(float)
    truth = np.tile(np.eye(4), (n**3, 1, 1))
    truth[:, :3, :3] = rotations_from_quaternions(rng.normal(size=(n**3, 4)))
    truth[:, :3, 3] = positions
    return World(truth, some(rng, near(positions, 1.1, 1), 40), (0.02, 0.005), (2500.0, 40000.0))


def sphere(rng: np.random.Generator) -> World:
    """120 poses wound up a sphere, 40 loops from one turn to the next."""
    return _wound_up(rng, 120, 20, 40)


def large_sphere(rng: np.random.Generator) -> World:
    """1000 poses wound up a sphere, 300 loops."""
    return _wound_up(rng, 1000, 40, 300)


def _wound_up(rng: np.random.Generator, count: int, turn: int, loops: int) -> World:
    steps = np.arange(count)
    around, height = 2 * np.pi * steps / turn, np.linspace(-0.9, 0.9, count)
    across = np.sqrt(1 - height**2)
    normal = np.stack([across * np.cos(around), across * np.sin(around), height], axis=1)
    turns = np.stack([steps[:-turn], steps[turn:]], axis=1)
    truth = facing(10 * normal, normal)
    return World(truth, some(rng, turns, loops), (0.02, 0.005), (2500.0, 40000.0))


def measured(world: World, rng: np.random.Generator) -> PoseGraph:
    """The world's pose graph, from its odometry, with the first pose fixed."""
    count = len(world.truth)
    chain = np.stack([np.arange(count - 1), np.arange(1, count)], axis=1)
    ends = np.concatenate([chain, world.loops])
    a, b = world.truth[ends[:, 0]], world.truth[ends[:, 1]]
    between = np.linalg.inv(a) @ b @ shaken(rng, len(ends), world.noise)
    weight = jnp.asarray(np.diag(np.repeat(world.information, 3)), jnp.float32)
    edges = RelativePose(ends, motions(between), weight)
    return PoseGraph(spanning_tree_start(edges, count), edges, np.arange(count), np.arange(count) == 0)


def shaken(rng: np.random.Generator, count: int, noise: tuple[float, float]) -> np.ndarray:
    """Small motions."""
    half = rng.normal(scale=noise[1] / 2, size=(count, 3))
    matrices = np.tile(np.eye(4), (count, 1, 1))
    matrices[:, :3, :3] = rotations_from_quaternions(np.concatenate([np.ones((count, 1)), half], axis=1))
    matrices[:, :3, 3] = rng.normal(scale=noise[0], size=(count, 3))
    return matrices


def with_false_loops(
    graph: PoseGraph, rng: np.random.Generator, share: float
) -> tuple[RelativePose, np.ndarray]:
    """Loops of which a share is false, and which: motions measured elsewhere, between poses at random."""
    count = len(graph.vertices)
    ends, Z = np.asarray(graph.edges.poses), np.asarray(graph.edges.T_a_b.wxyz_xyz)
    ends, Z = ends[count - 1 :], Z[count - 1 :]
    wrong = round(len(ends) * share / (1 - share))
    pairs = np.stack([rng.permutation(count)[:wrong] for _ in range(2)], axis=1)
    Z = np.concatenate([Z, Z[rng.integers(0, len(Z), wrong)]])
    loops = RelativePose(np.concatenate([ends, pairs]), jaxlie.SE3(jnp.asarray(Z)), graph.edges.matrices[0])
    return loops, np.arange(len(Z)) >= len(ends)
