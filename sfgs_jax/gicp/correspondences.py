"""Projective data association: a source point meets the target surface its pixel sees."""

import equinox as eqx
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Bool, Float

from sfgs_jax.geometry import se3
from sfgs_jax.gicp.cloud import OrganisedLevel


class Samples(eqx.Module):
    """Source points to align.

    Attributes:
        points: (N, 3) metres, source coordinates.
        normals: (N, 3) unit normals.
        valid: (N,) mask.
    """

    points: Float[Array, "N 3"]
    normals: Float[Array, "N 3"]
    valid: Bool[Array, " N"]


class Correspondences(eqx.Module):
    """For each source sample the target surface it meets, in *source* coordinates.

    In those the Jacobian of a right perturbation depends on the source point alone.

    Attributes:
        points: (N, 3) target points, metres.
        normals: (N, 3) target normals.
        found: (N,) whether there is one that passes the gates.
    """

    points: Float[Array, "N 3"]
    normals: Float[Array, "N 3"]
    found: Bool[Array, " N"]


def sample(level: OrganisedLevel, stride: int) -> Samples:
    """Every stride-th row and column of a level."""
    points, normals, valid = (x[::stride, ::stride] for x in (level.points, level.normals, level.valid))
    return Samples(points.reshape(-1, 3), normals.reshape(-1, 3), valid.reshape(-1))


def associate(
    source: Samples,
    target: OrganisedLevel,
    T_target_source: jaxlie.SE3,
    *,
    max_distance: float,
    min_normal_cosine: float,
) -> Correspondences:
    """Project each source point into the target and take the surface at the nearest pixel.

    Args:
        source: points to find correspondences for.
        target: organised target.
        T_target_source: motion to project with.
        max_distance: farthest a correspondence may be, metres.
        min_normal_cosine: least cosine of the angle between the two normals.
    """
    height, width = target.camera.shape
    moved = se3.transform(T_target_source, source.points)
    pixels = jnp.round(target.camera.project(moved))
    u, v = pixels[:, 0], pixels[:, 1]
    inside = (moved[:, 2] > 0) & (u >= 0) & (u < width) & (v >= 0) & (v < height) & source.valid
    index = jnp.where(inside, v * width + u, 0).astype(jnp.int32)
    points = target.points.reshape(-1, 3)[index]
    normals = target.normals.reshape(-1, 3)[index]

    rotation = se3.rotation_matrix(T_target_source)
    points = (points - T_target_source.wxyz_xyz[4:]) @ rotation  # rows times R: R^T on each
    normals = normals @ rotation
    near = jnp.sum((points - source.points) ** 2, axis=-1) < max_distance**2
    alike = jnp.sum(normals * source.normals, axis=-1) > min_normal_cosine
    return Correspondences(points, normals, inside & target.valid.reshape(-1)[index] & near & alike)
