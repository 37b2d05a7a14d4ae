"""Gauge of a pose graph: the one fixed pose that holds the others in place.

When all factors are relative, the cost is invariant to a rigid motion of all poses: the gauge freedom. Fixing
one pose settles the gauge, but makes the graph hard to solve. A turn about the fixed pose costs next to
nothing, yet moves far poses a long way, which neither a linear model nor float32 can follow. So the solver
frees the gauge pose, and damping alone keeps the steps short. In the end it moves all poses as one body, to
bring the gauge pose back to its place.
"""

from collections.abc import Sequence

import jax.numpy as jnp
import jaxlie
import numpy as np
import scipy.sparse as sparse
from jaxtyping import Array, Bool, Int
from scipy.sparse.csgraph import connected_components

from sfgs_jax.factor_graph._values import Values
from sfgs_jax.factor_graph.factors._factor import Factor
from sfgs_jax.geometry import se3


def find_gauge_pose(
    factors: Sequence[Factor], free_poses: Bool[np.ndarray, " P"]
) -> Int[np.ndarray, ""] | None:
    """The only fixed pose of a connected graph whose factors are all relative; None for any other graph.

    Args:
        factors: blocks whose indices are in range.
        free_poses: (P,) poses to solve for.
    """
    if not all(factor.relative for factor in factors):
        return None
    ends = np.concatenate([np.zeros((0, 2), np.int32), *(f.groups[f.group_valid] for f in factors)])
    used = np.unique(ends)
    fixed = used[~free_poses[used]]
    if len(fixed) != 1:
        return None
    count = len(free_poses)
    links = sparse.coo_array((np.ones(len(ends), np.int8), (ends[:, 0], ends[:, 1])), (count, count))
    _, component = connected_components(links, directed=False)
    return np.asarray(fixed[0], np.int32) if np.all(component[used] == component[fixed[0]]) else None


def restore_gauge(
    values: Values, given: Values, gauge_pose: Int[Array | np.ndarray, ""], free_poses: Bool[Array, " P"]
) -> Values:
    """Move all poses as one body, so that the gauge pose is as given; other fixed poses are as given too.

    Args:
        values: the solution of the graph with a free gauge.
        given: values with the gauge pose in its place.
        gauge_pose: its index.
        free_poses: (P,) poses that were solved for, without the gauge pose.
    """
    at, index = given.poses.wxyz_xyz, jnp.asarray(gauge_pose)
    reached = jaxlie.SE3(values.poses.wxyz_xyz[index])
    back = se3.compose(jaxlie.SE3(at[index]), se3.inverse(reached))
    whole = jaxlie.SE3(jnp.broadcast_to(back.wxyz_xyz[None], at.shape))
    moved = se3.compose(whole, values.poses).wxyz_xyz
    return Values(jaxlie.SE3(jnp.where(free_poses[:, None], moved, at)), values.landmarks)
