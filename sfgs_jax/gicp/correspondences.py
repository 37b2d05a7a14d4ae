"""Data association: for each source point the target surface that it meets.

In an organised target that is what the point's pixel sees, in an unorganised one the nearest point.
"""

import equinox as eqx
import jax.numpy as jnp
import jaxlie
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.geometry import Camera, se3
from sfgs_jax.gicp.cloud import OrganisedLevel
from sfgs_jax.gicp.config import GicpConfig, at_level
from sfgs_jax.gicp.point_cloud import PointLevel
from sfgs_jax.gicp.spatial_hash import SpatialHash, nearest
from sfgs_jax.gicp.symmetric import INDICES, Symmetric, smallest_eigenpair

NEAREST_SLOTS = 32


class Samples(eqx.Module):
    """Source points to align, one coordinate a row: arithmetic on rows is what XLA vectorises.

    Attributes:
        points: (3, N) metres, source coordinates.
        normals: (3, N) unit normals.
        variance: (N,) or (1,) variance expected of a distance along the normal, square metres.
        valid: (N,) mask.
        oriented: whether the normals face the sensor; else they have either sign. Static.
    """

    points: Float[Array, "3 N"]
    normals: Float[Array, "3 N"]
    variance: Float[Array, " V"]
    valid: Bool[Array, " N"]
    oriented: bool = eqx.field(static=True)


class Target(eqx.Module):
    """Target surface, one pixel or point a row: a row is what a gather copies at once.

    Attributes:
        rows: (M, 6) point and normal of each pixel or point, 0 where there is no surface; (M, 9) with the
            triangle of the shape instead of the normal for Gaussians; (M, 3) where the target has neither.
        variance: what the target adds to a distance's variance, square metres.
        max_distance: farthest that a correspondence may be, metres.
        min_normal_cosine: least cosine between the normals of a correspondence.
        search: camera of an organised target, hash of an unorganised one.
        oriented: whether the normals face the sensor; static.
        window: pixels around the one that a point meets in which the nearest point is looked for; static.
    """

    rows: Float[Array, "M C"]
    variance: Float[Array, ""]
    max_distance: Float[Array, ""]
    min_normal_cosine: Float[Array, ""]
    search: Camera | SpatialHash
    oriented: bool = eqx.field(static=True)
    window: int = eqx.field(static=True, default=0)


class Correspondences(eqx.Module):
    """For each source sample the target surface it meets, in *source* coordinates.

    In those the Jacobian of a right perturbation depends on the source point alone.

    Attributes:
        points: (3, N) target points, metres.
        normals: (3, N) target normals; the source's own where the target has none.
        shapes: (6, N) covariances of a Gaussian target, the largest variance about 1; else None.
        variance: (N,) variance expected of a distance along the normal, square metres.
        met: (N,) whether there is any, near or not.
        found: (N,) whether there is one that passes the gates.
    """

    points: Float[Array, "3 N"]
    normals: Float[Array, "3 N"]
    shapes: Symmetric | None
    variance: Float[Array, " N"]
    met: Bool[Array, " N"]
    found: Bool[Array, " N"]


def samples_of(level: OrganisedLevel | PointLevel, stride: int, config: GicpConfig) -> Samples:
    """A level's points as source: of an organised one every stride-th row and column."""
    if isinstance(level, PointLevel):
        variance = level.deviation[None] ** 2
        return Samples(level.points.T, level.normals.T, variance, level.valid, oriented=False)
    surface, valid = (x[::stride, ::stride] for x in (level.surface, level.valid))
    columns = surface.reshape(-1, 6).T
    variance = (config.noise + config.noise_per_square_metre * columns[2] ** 2) ** 2
    return Samples(columns[:3], columns[3:], variance, valid.reshape(-1), oriented=True)


def target_of(level: OrganisedLevel | PointLevel, index: int, config: GicpConfig) -> Target:
    """A level as target; `index` counts from the finest."""
    cosine = at_level(config.min_normal_cosine, index)
    if isinstance(level, OrganisedLevel):
        rows = level.surface.reshape(-1, 6)
        zero = jnp.zeros((), rows.dtype)
        reach = zero + at_level(config.max_distance, index)
        window = at_level(config.windows, index)
        return Target(rows, zero, reach, zero + cosine, level.camera, oriented=True, window=window)
    match level.covariance:
        case "neighbours":
            rows = jnp.concatenate([level.points, level.normals], axis=1)
        case "map":
            rows = jnp.concatenate([level.points, _shapes(level.covariances, config.epsilon)], axis=1)
        case "isotropic":
            rows = level.points
    reach = config.max_voxels * level.voxel_size
    return Target(rows, level.deviation**2, reach, jnp.full_like(reach, cosine), level.grid, oriented=False)


def _shapes(covariances: Float[Array, "M 3 3"], epsilon: float) -> Float[Array, "M 6"]:
    """Covariances divided by their largest variance, with at least `epsilon` in every direction."""
    entries = jnp.stack([covariances[:, i, j] for i, j in INDICES])
    trace = entries[0] + entries[3] + entries[5]
    unit = jnp.stack([jnp.full_like(trace, float(i == j)) for i, j in INDICES])
    # The largest variance is what the smallest one of (trace I - A) is short of the trace.
    largest = trace - smallest_eigenpair(trace * unit - entries)[0]
    scaled = entries / jnp.where(largest > 0, largest, 1)
    return ((1 - epsilon) * scaled + epsilon * unit).T


def dot(a: Float[Array, "3 ..."], b: Float[Array, "3 ..."]) -> Float[Array, "..."]:
    """Scalar products, written out: XLA does not vectorise a sum over three rows."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def associate(
    source: Samples, target: Target, T_target_source: jaxlie.SE3
) -> tuple[Correspondences, Int[Array, " N"]]:
    """Correspondences at a motion, and the target's row of each."""
    index, inside = _find(source, target, T_target_source)
    pairs = pair(source, target, T_target_source, index, inside)
    offset = source.points - pairs.points
    near = dot(offset, offset) < target.max_distance**2
    alike = dot(pairs.normals, source.normals) > target.min_normal_cosine
    # A pixel without a surface has a zero normal, which is like none.
    met = inside & (dot(pairs.normals, pairs.normals) > 0)
    return eqx.tree_at(lambda p: (p.met, p.found), pairs, (met, inside & near & alike)), index


def _find(
    source: Samples, target: Target, T_target_source: jaxlie.SE3
) -> tuple[Int[Array, " N"], Bool[Array, " N"]]:
    """Row of the target that each source point meets, and whether there is one."""
    rotation, translation = se3.rotation_matrix(T_target_source), T_target_source.wxyz_xyz[4:]
    moved = rotation @ source.points + translation[:, None]
    if isinstance(target.search, SpatialHash):
        index, found = nearest(target.search, moved, slots=NEAREST_SLOTS)
        return index, found & source.valid
    index, inside = _seen(target.search, moved, target.window)
    if target.window > 0:
        surface = jnp.any(target.rows[:, 3:6] != 0, axis=1, keepdims=True)
        # One coordinate at a time: XLA takes much longer for triples.
        columns = jnp.where(surface, target.rows[:, :3], jnp.inf).T
        square = sum(
            (m - c.at[index].get(mode="promise_in_bounds")) ** 2 for m, c in zip(moved, columns, strict=True)
        )
        square = jnp.where(inside, square, jnp.inf)
        best = _least(square)[None]
        index, inside = (jnp.take_along_axis(x, best, axis=0) for x in (index, inside))
    return index[0], inside[0] & source.valid


def _least(squares: Float[Array, "K N"]) -> Int[Array, " N"]:
    """Row of the least number of each column; numbers not below 0 that are within 2^-16 of it count as equal.

    The bits of such floats are in the order of the numbers. With the row in the lowest bits a plain minimum,
    which XLA vectorises, finds both; its argmin takes several times as long.
    """
    count = squares.shape[0]
    mask = (1 << (count - 1).bit_length()) - 1
    bits = lax.bitcast_convert_type(squares.astype(jnp.float32), jnp.int32)
    return jnp.min((bits & ~mask) | jnp.arange(count, dtype=jnp.int32)[:, None], axis=0) & mask


def _seen(
    camera: Camera, points: Float[Array, "3 N"], window: int
) -> tuple[Int[Array, "K N"], Bool[Array, "K N"]]:
    """The pixels of the window around each point's, and whether they are in the image."""
    x, y, z = points
    inverse = 1 / jnp.maximum(z, 1e-6)
    shifts = jnp.arange(-window, window + 1, dtype=x.dtype)
    du, dv = (shift.reshape(-1, 1) for shift in jnp.meshgrid(shifts, shifts))
    u = jnp.round(camera.fx * x * inverse + camera.cx) + du
    v = jnp.round(camera.fy * y * inverse + camera.cy) + dv
    inside = (z > 0) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    return jnp.where(inside, v * camera.width + u, 0).astype(jnp.int32), inside


def pair(
    source: Samples,
    target: Target,
    T_target_source: jaxlie.SE3,
    index: Int[Array, " N"],
    found: Bool[Array, " N"],
) -> Correspondences:
    """Given rows of the target, in source coordinates."""
    rotation, translation = se3.rotation_matrix(T_target_source), T_target_source.wxyz_xyz[4:]
    rows = target.rows.at[index].get(mode="promise_in_bounds")
    width = rows.shape[1]

    # One product turns everything into source coordinates and rows into columns.
    turn = jnp.zeros((width, width), rotation.dtype).at[:3, :3].set(rotation.T)
    if width == 6:
        turn = turn.at[3:, 3:].set(rotation.T)
    elif width == 9:
        turn = turn.at[3:, 3:].set(_turn_symmetric(rotation.T))
    turned = turn @ rows.T
    points = turned[:3] - (rotation.T @ translation)[:, None]
    normals, shapes = source.normals, None
    if width == 6:
        normals = turned[3:]
        if not (source.oriented and target.oriented):
            normals = jnp.where(dot(normals, source.normals) < 0, -normals, normals)
    elif width == 9:
        shapes = turned[3:]
    variance = jnp.broadcast_to(source.variance + target.variance, found.shape)
    return Correspondences(points, normals, shapes, variance, found, found)


def _turn_symmetric(rotation: Float[Array, "3 3"]) -> Float[Array, "6 6"]:
    """What takes the triangle of A to that of R A R^T."""
    full = jnp.einsum("ia,jb->ijab", rotation, rotation)
    columns = [full[:, :, a, b] if a == b else full[:, :, a, b] + full[:, :, b, a] for a, b in INDICES]
    stacked = jnp.stack(columns, axis=-1)
    return jnp.stack([stacked[i, j] for i, j in INDICES])
