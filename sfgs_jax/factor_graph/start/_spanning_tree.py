"""Spanning tree start: poses found by following measured motions one after the other."""

import jax.numpy as jnp
import jaxlie
import numpy as np
import scipy.sparse as sparse
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

from sfgs_jax.arrays import checked
from sfgs_jax.factor_graph._values import Values
from sfgs_jax.factor_graph.factors._pose_factors import RelativePose
from sfgs_jax.geometry import quaternions_from_rotations, se3


@checked
def spanning_tree_start(edges: RelativePose, num_poses: int) -> Values:
    """Poses along the minimum spanning tree of the measured motions, weighed by the time that they span.

    A graph with an edge between all consecutive poses thus starts from its odometry. The first pose is at the
    origin; in a graph of several components, the first pose of each.

    Args:
        edges: measured motions; masked ones are not followed.
        num_poses: P, indices in order of time.
    """
    valid = np.asarray(edges.valid)
    ends = np.asarray(edges.poses)[valid].astype(np.int64)
    motions = se3.to_matrices(edges.T_a_b)[valid]
    steps: dict[tuple[int, int], np.ndarray] = {}
    for (a, b), T in zip(ends.tolist(), motions, strict=True):
        steps.setdefault((a, b), T)
        steps.setdefault((b, a), np.linalg.inv(T))
    i, j = np.array(list(steps), np.int64).reshape(-1, 2).T
    links = sparse.csr_array((np.abs(i - j).astype(float), (i, j)), (num_poses, num_poses))
    tree = minimum_spanning_tree(links)
    poses = np.tile(np.eye(4), (num_poses, 1, 1))
    _, component = connected_components(tree, directed=False)
    for first in np.unique(component, return_index=True)[1]:
        order, before = breadth_first_order(tree, first, directed=False)
        for pose in order[1:].tolist():
            known = int(before[pose])
            poses[pose] = poses[known] @ steps[known, pose]
    wxyz = quaternions_from_rotations(poses[:, :3, :3])
    dtype = edges.T_a_b.wxyz_xyz.dtype
    return Values(jaxlie.SE3(jnp.asarray(np.concatenate([wxyz, poses[:, :3, 3]], axis=1), dtype)))
