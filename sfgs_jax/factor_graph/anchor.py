"""The one pose that holds a pose graph in place.

When all factors are relative, the cost does not change as all poses move as one rigid body. Fixing one pose
settles where that body is, but makes it hard to solve for: what turns the body about that pose costs next to
nothing yet moves far poses a long way, which neither a linear model nor float32 can follow. So the solver
lets the anchor go, takes the short steps that damping alone singles out, and in the end moves the whole body
to where the anchor is back in its place.
"""

from collections.abc import Sequence

import jax.numpy as jnp
import jaxlie
import numpy as np
import scipy.sparse as sparse
from jaxtyping import Array, Bool, Int
from scipy.sparse.csgraph import connected_components

from sfgs_jax.factor_graph.factor import Factor
from sfgs_jax.factor_graph.values import Values
from sfgs_jax.geometry import se3


def find_anchor(factors: Sequence[Factor], free_poses: Bool[np.ndarray, " P"]) -> Int[np.ndarray, ""] | None:
    """The only fixed pose of a connected graph whose factors are all relative; None of any other graph."""
    if not all(factor.relative for factor in factors):
        return None
    ends = np.concatenate([np.zeros((0, 2), np.int32), *(f.groups[f.group_valid] for f in factors)])
    used = np.unique(ends)
    anchors = used[~free_poses[used]]
    if len(anchors) != 1:
        return None
    count = len(free_poses)
    links = sparse.coo_array((np.ones(len(ends), np.int8), (ends[:, 0], ends[:, 1])), (count, count))
    _, piece = connected_components(links, directed=False)
    return np.asarray(anchors[0], np.int32) if np.all(piece[used] == piece[anchors[0]]) else None


def move_back(
    values: Values, given: Values, anchor: Int[Array | np.ndarray, ""], free_poses: Bool[Array, " P"]
) -> Values:
    """Values moved as one body to where the anchor is as given; poses that are not free are as given too."""
    at, index = given.poses.wxyz_xyz, jnp.asarray(anchor)
    reached = jaxlie.SE3(values.poses.wxyz_xyz[index])
    back = se3.compose(jaxlie.SE3(at[index]), se3.inverse(reached))
    whole = jaxlie.SE3(jnp.broadcast_to(back.wxyz_xyz, at.shape))
    moved = se3.compose(whole, values.poses).wxyz_xyz
    return Values(jaxlie.SE3(jnp.where(free_poses[:, None], moved, at)), values.landmarks)
