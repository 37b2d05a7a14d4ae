"""Projective data association: a source point meets the target surface its pixel sees."""

import equinox as eqx
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Bool, Float

from sfgs_jax.geometry import Camera, se3
from sfgs_jax.gicp.cloud import OrganisedLevel


class Samples(eqx.Module):
    """Source points to align, one coordinate a row: arithmetic on rows is what XLA vectorises.

    Attributes:
        points: (3, N) metres, source coordinates.
        normals: (3, N) unit normals.
        valid: (N,) mask.
    """

    points: Float[Array, "3 N"]
    normals: Float[Array, "3 N"]
    valid: Bool[Array, " N"]


class TargetRows(eqx.Module):
    """Target surface, one pixel a row: a row is what a gather copies at once.

    Attributes:
        rows: (H * W, 6) point and normal of each pixel, 0 where there is no surface.
        camera: intrinsics of that image.
    """

    rows: Float[Array, "M 6"]
    camera: Camera


class Correspondences(eqx.Module):
    """For each source sample the target surface it meets, in *source* coordinates.

    In those the Jacobian of a right perturbation depends on the source point alone.

    Attributes:
        points: (3, N) target points, metres.
        normals: (3, N) target normals.
        found: (N,) whether there is one that passes the gates.
    """

    points: Float[Array, "3 N"]
    normals: Float[Array, "3 N"]
    found: Bool[Array, " N"]


def sample(level: OrganisedLevel, stride: int) -> Samples:
    """Every stride-th row and column of a level."""
    points, normals, valid = (x[::stride, ::stride] for x in (level.points, level.normals, level.valid))
    return Samples(points.reshape(-1, 3).T, normals.reshape(-1, 3).T, valid.reshape(-1))


def target_rows(level: OrganisedLevel) -> TargetRows:
    """A level, laid out for `associate`."""
    return TargetRows(jnp.concatenate([level.points, level.normals], axis=-1).reshape(-1, 6), level.camera)


def dot(a: Float[Array, "3 N"], b: Float[Array, "3 N"]) -> Float[Array, " N"]:
    """Scalar products, written out: XLA does not vectorise a sum over three rows."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def associate(
    source: Samples,
    target: TargetRows,
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
    camera = target.camera
    rotation, translation = se3.rotation_matrix(T_target_source), T_target_source.wxyz_xyz[4:]
    x, y, z = rotation @ source.points + translation[:, None]
    inverse = 1 / jnp.maximum(z, 1e-6)
    u = jnp.round(camera.fx * x * inverse + camera.cx)
    v = jnp.round(camera.fy * y * inverse + camera.cy)
    inside = (z > 0) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height) & source.valid
    index = jnp.where(inside, v * camera.width + u, 0).astype(jnp.int32)
    rows = target.rows.at[index].get(mode="promise_in_bounds")

    # One product turns points and normals into source coordinates and rows into columns.
    turn = jnp.zeros((6, 6), rotation.dtype).at[:3, :3].set(rotation.T).at[3:, 3:].set(rotation.T)
    turned = turn @ rows.T
    points = turned[:3] - (rotation.T @ translation)[:, None]
    normals = turned[3:]
    offset = source.points - points
    near = dot(offset, offset) < max_distance**2
    # A pixel without a surface has a zero normal, which fails here.
    alike = dot(normals, source.normals) > min_normal_cosine
    return Correspondences(points, normals, inside & near & alike)
