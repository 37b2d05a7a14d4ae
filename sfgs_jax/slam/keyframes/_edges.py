"""Edges of the keyframe graph: from registrations, and as a block of factors."""

from collections.abc import Sequence

import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from sfgs_jax.factor_graph import RelativePose
from sfgs_jax.geometry import Kernel, se3
from sfgs_jax.slam.config import GraphConfig
from sfgs_jax.slam.keyframes._depth_equations import DepthEquations
from sfgs_jax.slam.state._keyframe_graph import Edge, EdgeNoise
from sfgs_jax.slam.state._registration import PoseSource, Registration

_METRES, _RADIANS = 0.01, 0.007
"""Errors that count as alike: a turn by the second moves what is 1.5 m away by the first."""
CONSISTENT = float(chi2.ppf(0.99, 6))
"""Squared deviation of a motion's six degrees of freedom that chance exceeds in one case of a hundred."""
_LEAST_SHARE = 1e-4
"""Least information of a direction that the surface fixes, as a share of the largest: a hundred times the
deviation. Beyond it float32 leaves little of the gradient."""


def prior_noise(config: GraphConfig) -> EdgeNoise:
    """Noise of edges as known before the first cycle.

    Args:
        config: settings.
    """
    return EdgeNoise(np.diag(np.repeat([config.edge_sigma_metres, config.edge_sigma_radians], 3) ** 2), 1.0)


def edge_of(
    target: int,
    source: int,
    found: Registration,
    config: GraphConfig,
    depth_parameters: Float[np.ndarray, " G"],
    depth: DepthEquations | None = None,
) -> Edge:
    """A registration as an edge of the graph.

    Args:
        target: number of the keyframe registered to.
        source: number of the keyframe registered.
        found: the registration.
        config: settings.
        depth_parameters: (G,) of the depth correction that it was found with; none if depth is not corrected.
        depth: equations of the errors of depth, which say how the motion changes with them; None if unknown.
    """
    unknown = np.zeros((6, len(depth_parameters)))
    return Edge(
        target=target,
        source=source,
        T_target_source=np.asarray(found.T_target_source.wxyz_xyz),
        information=np.asarray(found.information),
        surface_motion=_surface_motion(found),
        surface_information=np.asarray(found.surface_information),
        revisit=source - target > config.loop_gap,
        loop=False,
        depth_parameters=depth_parameters,
        sensitivity=unknown if depth is None else depth.sensitivity,
        surface_sensitivity=unknown if depth is None else depth.surface_sensitivity,
    )


def _surface_motion(found: Registration) -> Float[np.ndarray, "7"]:
    """The motion at which the surface's own residuals are least, without the pull of the keypoints.

    At the motion found, the gradients of surface and keypoints cancel. The keypoints' gradient is known from
    their own optimum, so the surface's is too, and a Newton step leads to its optimum. Directions that the
    surface leaves free stay as they are.
    """
    motion = np.asarray(found.T_target_source.wxyz_xyz)
    if int(found.source) != PoseSource.JOINT:
        return motion
    by_keypoints, joint = (
        se3.matrices_of(np.asarray(T.wxyz_xyz)[None])[0].astype(np.float64)
        for T in (found.matched.T_target_source, found.T_target_source)
    )
    off = se3.logs_of((np.linalg.inv(by_keypoints) @ joint)[None])[0]
    gradient = np.asarray(found.matched.information, np.float64) @ off
    # In units in which a registration errs alike in all directions, eigenvalues can be compared.
    units = np.repeat([_METRES, _RADIANS], 3)
    values, vectors = np.linalg.eigh(units[:, None] * np.asarray(found.surface_information, float) * units)
    fixed = values > _LEAST_SHARE * values[-1]
    shares = np.where(fixed, vectors.T @ (units * gradient) / np.where(fixed, values, 1), 0)
    return _shifted(motion[None], (units * (vectors @ shares))[None])[0].astype(np.float32)


def motions_of(
    edges: Sequence[Edge], depth_parameters: Float[np.ndarray, " G"], *, surface_only: bool = False
) -> Float[np.ndarray, "n 7"]:
    """Motions of some edges, as wxyz_xyz.

    Args:
        edges: at least one.
        depth_parameters: (G,) of the depth correction that they should be for.
        surface_only: whether to take what the surface alone says.
    """
    motions = np.stack([edge.surface_motion if surface_only else edge.T_target_source for edge in edges])
    if not len(depth_parameters):
        return motions
    shifts = [
        (edge.surface_sensitivity if surface_only else edge.sensitivity)
        @ (depth_parameters - edge.depth_parameters)
        for edge in edges
    ]
    return _shifted(motions, np.stack(shifts))


def relative_poses(
    edges: Sequence[Edge],
    capacity: int,
    *,
    noise: EdgeNoise,
    depth_parameters: Float[np.ndarray, " G"],
    surface_only: bool = False,
    kernel: Kernel = "none",
    kernel_width: float = 1.0,
) -> RelativePose:
    """Edges as one padded block of factors, each with its part of what they say together.

    Args:
        edges: at most `capacity` of them.
        capacity: rows of the block.
        noise: of the edges.
        depth_parameters: (G,) of the depth correction that the motions should be for.
        surface_only: whether to take what the surface alone says.
        kernel: robust kernel.
        kernel_width: its width, standard deviations of an edge.
    """
    count = len(edges)
    poses = np.tile(np.asarray([0, 1], np.int32), (capacity, 1))
    motions = np.tile(np.asarray([1, 0, 0, 0, 0, 0, 0], np.float32), (capacity, 1))
    information = np.tile(np.eye(6, dtype=np.float32), (capacity, 1, 1))
    if count:
        poses[:count] = [(edge.target, edge.source) for edge in edges]
        motions[:count] = motions_of(edges, depth_parameters, surface_only=surface_only)
        told = [edge.surface_information if surface_only else edge.information for edge in edges]
        information[:count] = noise.share(np.stack(told))
    return RelativePose(
        poses,
        jaxlie.SE3(jnp.asarray(motions)),
        jnp.asarray(information),
        valid=np.arange(capacity) < count,
        kernel=kernel,
        # The kernel judges an edge by its own deviations, not by those of its part.
        kernel_width=kernel_width / noise.redundancy**0.5,
    )


def _shifted(motions: Float[np.ndarray, "n 7"], shifts: Float[np.ndarray, "n 6"]) -> Float[np.ndarray, "n 7"]:
    """Motions as wxyz_xyz, perturbed on the right by tangents of a few centimetres."""
    rotations = Rotation.from_quat(motions[:, :4], scalar_first=True)
    turned = (rotations * Rotation.from_rotvec(shifts[:, 3:])).as_quat(scalar_first=True)
    return np.concatenate([turned, motions[:, 4:] + rotations.apply(shifts[:, :3])], axis=1)
