"""Rigid motions on jaxlie, and their counterparts on the host.

Poses are `jaxlie.SE3`; public functions take homogeneous 4 x 4 matrices too (`as_se3`), and `matrix` gives
them back. Tangents are jaxlie's (translation first, then rotation) and perturb on the right:
`T @ exp(delta)`. Functions of `jaxlie.SE3` run on the device, with products in full float32. TF32,
the default on recent GPUs, would move a point five metres away by millimetres. Functions of NumPy arrays run
on the host in float64.

The library calls jaxlie's arithmetic here only. It mixes integers with floats and arrays of different rank.
Strict promotion refuses that, so promotion is allowed locally. Exponential, logarithm, adjoint and rotation
matrix are our own, as products with constant tensors. XLA compiles each small array of a program by itself,
and jaxlie builds these of many scalars: a quarter to two thirds of the arrays remain.
"""

import inspect
from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar, cast

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Num, Shaped

from sfgs_jax.arrays import InputError, checked, checked_but, described, is_array, is_known, printed
from sfgs_jax.geometry._rotations import (
    quaternions_from_rotations,
    rotation_vectors,
    rotations_from_quaternions,
)

__all__ = [
    "Pose",
    "adjoint",
    "adjoints_of",
    "as_se3",
    "compose",
    "composed_covariances",
    "exp",
    "exps_of",
    "extent",
    "from_matrix",
    "identity",
    "inverse",
    "log",
    "logs_of",
    "matrices_of",
    "matrix",
    "parameters_of",
    "plane_jacobian",
    "quaternion_product",
    "quaternions",
    "rotate",
    "rotation_matrix",
    "text_of",
    "to_matrices",
    "transform",
]


def __dir__() -> list[str]:
    return __all__


_P = ParamSpec("_P")
_R = TypeVar("_R")
_EXACT = jax.lax.Precision.HIGHEST

Pose = jaxlie.SE3 | Num[Array | np.ndarray, "*b 4 4"]
"""A rigid motion, or the homogeneous 4 x 4 matrix of one."""


def _rotation_tensor() -> np.ndarray:
    """(9, 16) map of products of a unit quaternion's entries to half its rotation matrix less 1."""
    tensor = np.zeros((3, 3, 4, 4))
    for i, j, k in [(0, 1, 2), (1, 2, 0), (2, 0, 1)]:
        tensor[i, i, [1 + j, 1 + k], [1 + j, 1 + k]] = -1
        tensor[i, j, [1 + i, 0], [1 + j, 1 + k]] = 1, -1
        tensor[j, i, [1 + i, 0], [1 + j, 1 + k]] = 1
    return tensor.reshape(9, 16)


def _cross_tensor() -> np.ndarray:
    """(9, 3) map of a vector to the matrix of its cross product, row by row."""
    tensor = np.zeros((3, 3, 3))
    for i, j, k in [(0, 1, 2), (1, 2, 0), (2, 0, 1)]:
        tensor[k, j, i], tensor[j, k, i] = 1, -1
    return tensor.reshape(9, 3)


_ROTATION, _CROSS = _rotation_tensor(), _cross_tensor()

_SMALL = 0.01
"""Squared angle below which power series take the place of quotients that would be 0 by 0."""

_TINY = 1e-4
"""The same for the logarithm's angle, whose quotient loses no digits; the series need fewer terms."""

_RIGID = 1e-3
"""Largest error of a rotation matrix's orthonormality; matrices in text files have few digits."""


def _promoting(function: Callable[_P, _R]) -> Callable[_P, _R]:
    @wraps(function)
    def wrapper(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        with (
            jax.numpy_dtype_promotion("standard"),
            jax.numpy_rank_promotion("allow"),
            jax.default_matmul_precision("highest"),
        ):
            return function(*args, **kwargs)

    # Called on the host, each is one small program rather than dozens; inside a larger one it dissolves.
    compiled = jax.jit(wrapper, inline=True)
    names = [name for name in inspect.signature(function).parameters if name.startswith("T")]

    @checked
    @wraps(function)
    def outer(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        # A matrix is looked at before it is traced: it may be no rigid motion.
        given = [as_se3(cast(Any, T), name=name, axes=None) for name, T in zip(names, args, strict=False)]
        named = {name: cast(Any, T) for name, T in kwargs.items()}
        named |= {name: as_se3(named[name], name=name, axes=None) for name in names if name in named}
        return cast(Callable[..., _R], compiled)(*given, *args[len(given) :], **named)

    return outer


@checked
def identity(dtype: jnp.dtype | type = jnp.float32) -> jaxlie.SE3:
    """The motion that leaves every point where it is."""
    return jaxlie.SE3(jnp.asarray([1, 0, 0, 0, 0, 0, 0], dtype))


def as_se3(
    pose: jaxlie.SE3 | Shaped[Array | np.ndarray, "..."], *, name: str = "A pose", axes: int | None = 0
) -> jaxlie.SE3:
    """The motion of a `jaxlie.SE3`, which is passed on, or of a homogeneous 4 x 4 matrix.

    Differentiable and free of checks of the values under `jit`; an array of the host keeps float64 until the
    quaternion is made.

    Args:
        pose: `jaxlie.SE3`, or a JAX or NumPy array (*axes, 4, 4).
        name: of the argument, at the beginning of a sentence.
        axes: number of leading axes; None allows any.

    Raises:
        InputError: it is neither, has another shape, or is no rigid motion.
    """
    if isinstance(pose, jaxlie.SE3):
        leading, kind = pose.wxyz_xyz.shape[:-1], "motions"
    elif isinstance(pose, jax.Array | np.ndarray):
        if pose.shape[-2:] != (4, 4):
            raise InputError(f"{name} is a jaxlie.SE3 or a 4 x 4 matrix, not an array of shape {pose.shape}.")
        leading, kind = pose.shape[:-2], "matrices"
    else:
        raise InputError(f"{name} is a jaxlie.SE3 or a 4 x 4 matrix, not {described(pose)}.")
    if axes is not None and len(leading) != axes:
        wanted = "one motion; use vmap for several" if axes == 0 else f"an array of motions with {axes} axis"
        raise InputError(f"{name} is {wanted}, not {kind} of shape {leading}.")
    return pose if isinstance(pose, jaxlie.SE3) else _from_matrices(pose, name)


def text_of(T: Any) -> str:
    """A motion as text, its translation in metres and its angle; of a traced or batched one the shape.

    Args:
        T: `jaxlie.SE3`; anything else is printed as it is.
    """
    parameters = getattr(T, "wxyz_xyz", T)
    if not is_array(parameters) or not is_known(parameters) or parameters.shape != (7,):
        return printed(parameters)
    wxyz, (x, y, z) = np.split(np.asarray(parameters, np.float64), [4])
    degrees = np.degrees(2 * np.arctan2(np.linalg.norm(wxyz[1:]), abs(wxyz[0])))
    return f"({x:.4g}, {y:.4g}, {z:.4g}) m {degrees:.3g}°"


def _from_matrices(matrices: Num[Array | np.ndarray, "*b 4 4"], name: str) -> jaxlie.SE3:
    floating = jnp.issubdtype(matrices.dtype, jnp.floating)
    dtype = jax.dtypes.canonicalize_dtype(matrices.dtype if floating else float)
    if isinstance(matrices, Tracer):
        wxyz = quaternions(matrices[..., :3, :3].astype(dtype).reshape(-1, 3, 3))
        wxyz = wxyz.reshape(*matrices.shape[:-2], 4)
        return jaxlie.SE3(jnp.concatenate([wxyz, matrices[..., :3, 3].astype(dtype)], axis=-1))
    host = np.asarray(matrices, np.float64).reshape(-1, 4, 4)
    R = host[:, :3, :3]
    error = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(initial=0)
    right = error < _RIGID and np.isfinite(host).all() and (np.linalg.det(R) > 0).all()
    if not right or np.any(host[:, 3] != [0, 0, 0, 1]):
        raise InputError(
            f"{name} is no rigid motion: a 4 x 4 matrix needs an orthonormal rotation, a finite translation "
            "in its last column, and the last row 0 0 0 1."
        )
    return jaxlie.SE3(jnp.asarray(parameters_of(host).reshape(*matrices.shape[:-2], 7), dtype))


@_promoting
def exp(tangent: Float[Array, "*b 6"]) -> jaxlie.SE3:
    """Motion of a tangent vector (translation first)."""
    moved, turned = tangent[..., :3], tangent[..., 3:]
    square = jnp.sum(turned**2, axis=-1, keepdims=True)
    small = square < _SMALL
    safe = jnp.where(small, 1, square)
    angle, s = jnp.sqrt(safe), jnp.where(small, square, 0)
    cosine = jnp.where(small, 1 - s / 8 * (1 - s / 48 * (1 - s / 120)), jnp.cos(angle / 2))
    sine = jnp.where(small, (1 - s / 24 * (1 - s / 80 * (1 - s / 168))) / 2, jnp.sin(angle / 2) / angle)
    # The angle less its sine, over its third power.
    bend = jnp.where(small, (1 - s / 20 * (1 - s / 42 * (1 - s / 72))) / 6, (1 - 2 * sine * cosine) / safe)
    cross = _cross_matrix(turned)
    across = _applied(cross, moved)
    position = moved + 2 * sine**2 * across + bend * _applied(cross, across)
    return jaxlie.SE3(jnp.concatenate([cosine, sine * turned, position], axis=-1))


@_promoting
def log(T: Pose) -> Float[Array, "*b 6"]:
    """Tangent vector (translation first) of a motion."""
    entries = as_se3(T, axes=None).wxyz_xyz
    w, axis, position = entries[..., :1], entries[..., 1:4], entries[..., 4:]
    # A rotation has two quaternions: this takes the one of the smaller angle.
    sign = jnp.where(w < 0, -1.0, 1.0).astype(w.dtype)
    w, square = sign * w, jnp.sum(axis**2, axis=-1, keepdims=True)
    tiny = square < _TINY
    sine, cosine = jnp.sqrt(jnp.where(tiny, 1, square)), jnp.where(tiny, w, 1)
    r = jnp.where(tiny, square, 0) / cosine**2
    series = (1 - r / 3 * (1 - r * (3 / 5) * (1 - r * (5 / 7)))) / cosine
    half = jnp.where(tiny, series, jnp.arctan2(sine, w) / sine)
    # Half the angle, squared, and one less it times its cotangent, over the angle squared.
    h = half**2 * square
    small = h < _SMALL
    s, large = jnp.where(small, h, 0), jnp.where(small, 1, h)
    bend = jnp.where(
        small,
        (1 + s / 15 * (1 + s * (2 / 21) * (1 + s / 10 * (1 + s * (10 / 99))))) / 12,
        (1 - half * w) / (4 * large),
    )
    cross, angle = _cross_matrix(axis), 2 * sign * half
    across = _applied(cross, position)
    moved = position - angle / 2 * across + bend * angle**2 * _applied(cross, across)
    return jnp.concatenate([moved, angle * axis], axis=-1)


@_promoting
def compose(T_a_b: Pose, T_b_c: Pose) -> jaxlie.SE3:
    """`T_a_c` of two motions, with the quaternion brought back to unit length."""
    product = as_se3(T_a_b, axes=None) @ as_se3(T_b_c, axes=None)
    wxyz = product.wxyz_xyz[..., :4]
    unit = wxyz / jnp.linalg.norm(wxyz, axis=-1, keepdims=True)
    return jaxlie.SE3(jnp.concatenate([unit, product.wxyz_xyz[..., 4:]], axis=-1))


@_promoting
def inverse(T_a_b: Pose) -> jaxlie.SE3:
    """`T_b_a`."""
    return as_se3(T_a_b, axes=None).inverse()


@_promoting
def matrix(T: Pose) -> Float[Array, "*b 4 4"]:
    """Homogeneous 4 x 4 matrix."""
    T = as_se3(T, axes=None)
    upper = jnp.concatenate([_rotation(T), T.wxyz_xyz[..., 4:, None]], axis=-1)
    last = jnp.broadcast_to(jnp.asarray([0, 0, 0, 1], upper.dtype), (*upper.shape[:-2], 1, 4))
    return jnp.concatenate([upper, last], axis=-2)


@_promoting
def adjoint(T: Pose) -> Float[Array, "*b 6 6"]:
    """Ad(T): `T @ exp(x) = exp(Ad(T) x) @ T`."""
    T = as_se3(T, axes=None)
    R = _rotation(T)
    coupling = jnp.matmul(_cross_matrix(T.wxyz_xyz[..., 4:]), R)
    upper = jnp.concatenate([R, coupling], axis=-1)
    return jnp.concatenate([upper, jnp.concatenate([jnp.zeros_like(R), R], axis=-1)], axis=-2)


@_promoting
def rotation_matrix(T: Pose) -> Float[Array, "*b 3 3"]:
    """Rotation part, 3 x 3."""
    return _rotation(as_se3(T, axes=None))


def _rotation(T: jaxlie.SE3) -> Float[Array, "*b 3 3"]:
    q = T.wxyz_xyz[..., :4]
    products = (q[..., :, None] * q[..., None, :]).reshape(*q.shape[:-1], 16)
    entries = jnp.matmul(products, jnp.asarray(_ROTATION.T, q.dtype), precision=_EXACT)
    twice = 2 * entries / jnp.sum(q**2, axis=-1, keepdims=True)
    return jnp.eye(3, dtype=q.dtype) + twice.reshape(*q.shape[:-1], 3, 3)


def _cross_matrix(vector: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    entries = jnp.matmul(vector, jnp.asarray(_CROSS.T, vector.dtype), precision=_EXACT)
    return entries.reshape(*vector.shape[:-1], 3, 3)


def _applied(matrix: Float[Array, "*b 3 3"], vector: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    return jnp.sum(matrix * vector[..., None, :], axis=-1)


@checked_but("T_a_b")
def transform(T_a_b: Pose, points: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
    """Points given in frame b, in frame a. One motion, any number of points."""
    T_a_b = as_se3(T_a_b, name="T_a_b")
    turned = jnp.einsum("ij,...j->...i", rotation_matrix(T_a_b), points, precision=_EXACT)
    return turned + T_a_b.wxyz_xyz[4:].reshape((1,) * (points.ndim - 1) + (3,))


def plane_jacobian(points: Float[Array, "3 N"], normals: Float[Array, "3 N"]) -> Float[Array, "6 N"]:
    """(6, N) derivative of n . exp(delta) p by delta: of distances along normals by a motion of the points.

    Args:
        points: (3, N) p, metres.
        normals: (3, N) n.
    """
    return jnp.concatenate([normals, jnp.cross(points, normals, axis=0)])


def extent(T: Pose) -> tuple[Float[Array, "*b"], Float[Array, "*b"]]:
    """Lengths of a motion's translation and rotation by its tangent, metres and radians."""
    tangent = log(T)
    return jnp.linalg.norm(tangent[..., :3], axis=-1), jnp.linalg.norm(tangent[..., 3:], axis=-1)


@checked
def quaternion_product(a: Float[Array, "*b 4"], b: Float[Array, "*b 4"]) -> Float[Array, "*b 4"]:
    """Hamilton product of quaternions wxyz of any length: the rotation b, then a."""
    w, v = a[..., :1], a[..., 1:]
    x, u = b[..., :1], b[..., 1:]
    scalar = w * x - jnp.sum(v * u, axis=-1, keepdims=True)
    return jnp.concatenate([scalar, w * u + x * v + jnp.cross(v, u)], axis=-1)


@checked
def rotate(quaternions: Float[Array, "*b 4"], points: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """Points rotated by unit quaternions wxyz, one each."""
    w, axis = quaternions[..., :1], quaternions[..., 1:]
    across = 2 * jnp.cross(axis, points)
    return points + w * across + jnp.cross(axis, across)


@checked
def from_matrix(matrix: Float[np.ndarray, "4 4"], dtype: jnp.dtype | type = jnp.float32) -> jaxlie.SE3:
    """Motion of a homogeneous matrix held on the host."""
    wxyz = quaternions_from_rotations(matrix[None, :3, :3])[0]
    return jaxlie.SE3(jnp.asarray(np.concatenate([wxyz, matrix[:3, 3]]), dtype))


@checked
def to_matrices(poses: jaxlie.SE3) -> Float[np.ndarray, "n 4 4"]:
    """Homogeneous matrices on the host, in float64, of a batch of n motions."""
    return matrices_of(np.asarray(poses.wxyz_xyz))


@checked
def matrices_of(parameters: Float[np.ndarray, "n 7"]) -> Float[np.ndarray, "n 4 4"]:
    """Homogeneous matrices on the host, in float64, of parameters wxyz_xyz."""
    parameters = np.asarray(parameters, np.float64)
    matrices = np.tile(np.eye(4), (len(parameters), 1, 1))
    matrices[:, :3, :3] = rotations_from_quaternions(parameters[:, :4])
    matrices[:, :3, 3] = parameters[:, 4:]
    return matrices


@checked
def parameters_of(matrices: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 7"]:
    """Poses as wxyz_xyz of matrices, on the host; `matrices_of` undoes it."""
    return np.concatenate([quaternions_from_rotations(matrices[:, :3, :3]), matrices[:, :3, 3]], axis=1)


@checked
def adjoints_of(matrices: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 6 6"]:
    """Ad(T) of homogeneous matrices on the host, in float64; translation first."""
    R, t = matrices[:, :3, :3], matrices[:, :3, 3]
    adjoints = np.zeros((len(matrices), 6, 6))
    adjoints[:, :3, :3] = adjoints[:, 3:, 3:] = R
    adjoints[:, :3, 3:] = np.cross(t[:, None], np.swapaxes(R, 1, 2)).swapaxes(1, 2)
    return adjoints


@checked
def composed_covariances(
    first: Float[np.ndarray, "n 6 6"], T_b_c: Float[np.ndarray, "n 4 4"], second: Float[np.ndarray, "n 6 6"]
) -> Float[np.ndarray, "n 6 6"]:
    """Covariances of the tangents of `T_a_c`, to first order; on the host.

    Source: Barfoot and Furgale, Associating Uncertainty with Three-Dimensional Poses (2014), equation 51.

    Args:
        first: of the tangents of `T_a_b`.
        T_b_c: homogeneous matrices.
        second: of the tangents of `T_b_c`, independent of the first.
    """
    adjoints = adjoints_of(np.linalg.inv(T_b_c))
    return adjoints @ first @ np.swapaxes(adjoints, 1, 2) + second


@checked
def logs_of(matrices: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 6"]:
    """Tangents (translation first) of homogeneous matrices on the host, in float64."""
    w, t = rotation_vectors(matrices[:, :3, :3]), matrices[:, :3, 3]
    angle = np.linalg.norm(w, axis=1, keepdims=True)
    half = np.maximum(angle, 1e-4) / 2  # below, the second-order term is less than rounding
    bend = (1 - half / np.tan(half)) / (2 * half) ** 2
    v = t - np.cross(w, t) / 2 + bend * np.cross(w, np.cross(w, t))
    return np.concatenate([v, w], axis=1)


@checked
def exps_of(tangents: Float[np.ndarray, "n 6"]) -> Float[np.ndarray, "n 4 4"]:
    """Homogeneous matrices of tangents (translation first) on the host, in float64; `logs_of` undoes it."""
    v, w = np.split(np.asarray(tangents, np.float64), 2, axis=1)
    turn = np.linalg.norm(w, axis=1, keepdims=True)
    half = np.sinc(turn / (2 * np.pi)) / 2  # sin(turn / 2) / turn
    angle = np.maximum(turn, 1e-4)  # below, the second-order term is less than rounding
    once = 2 * half**2 * np.cross(w, v)
    twice = (angle - np.sin(angle)) / angle**3 * np.cross(w, np.cross(w, v))
    matrices = np.tile(np.eye(4), (len(v), 1, 1))
    matrices[:, :3, :3] = rotations_from_quaternions(np.concatenate([np.cos(turn / 2), half * w], axis=1))
    matrices[:, :3, 3] = v + once + twice
    return matrices


@_promoting
def quaternions(rotations: Float[Array, "n 3 3"]) -> Float[Array, "n 4"]:
    """Unit quaternions wxyz of rotation matrices."""
    return jax.vmap(lambda rotation: jaxlie.SO3.from_matrix(rotation).wxyz)(rotations)
