"""Rigid motions on jaxlie.

Poses are `jaxlie.SE3` everywhere; tangents are jaxlie's (translation first, then rotation) and perturb
on the right: `T @ exp(delta)`. These functions are the only calls into jaxlie's arithmetic: jaxlie mixes
integer constants into float expressions, which strict dtype promotion refuses, so they allow it locally.
"""

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar, cast

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Float

from sfgs_jax.geometry.rotations import quaternions_from_rotations, rotations_from_quaternions

_P = ParamSpec("_P")
_R = TypeVar("_R")


def _promoting(function: Callable[_P, _R]) -> Callable[_P, _R]:
    @wraps(function)
    def wrapper(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        with jax.numpy_dtype_promotion("standard"):
            return function(*args, **kwargs)

    # Called on the host, each is one small program rather than dozens; inside a larger one it dissolves.
    return cast(Callable[_P, _R], jax.jit(wrapper, inline=True))


def identity(dtype: jnp.dtype | type = jnp.float32) -> jaxlie.SE3:
    """The motion that leaves every point where it is."""
    return jaxlie.SE3(jnp.asarray([1, 0, 0, 0, 0, 0, 0], dtype))


@_promoting
def exp(tangent: Float[Array, "*b 6"]) -> jaxlie.SE3:
    """Motion of a tangent vector (translation first)."""
    return jaxlie.SE3.exp(tangent)


@_promoting
def log(T: jaxlie.SE3) -> Float[Array, "*b 6"]:
    """Tangent vector (translation first) of a motion."""
    return T.log()


@_promoting
def compose(T_a_b: jaxlie.SE3, T_b_c: jaxlie.SE3) -> jaxlie.SE3:
    """`T_a_c` of two motions, with the quaternion brought back to unit length."""
    product = T_a_b @ T_b_c
    wxyz = product.wxyz_xyz[..., :4]
    unit = wxyz / jnp.linalg.norm(wxyz, axis=-1, keepdims=True)
    return jaxlie.SE3(jnp.concatenate([unit, product.wxyz_xyz[..., 4:]], axis=-1))


@_promoting
def inverse(T_a_b: jaxlie.SE3) -> jaxlie.SE3:
    """`T_b_a`."""
    return T_a_b.inverse()


@_promoting
def matrix(T: jaxlie.SE3) -> Float[Array, "*b 4 4"]:
    """Homogeneous 4 x 4 matrix."""
    return T.as_matrix()


@_promoting
def adjoint(T: jaxlie.SE3) -> Float[Array, "*b 6 6"]:
    """Ad(T): `T @ exp(x) = exp(Ad(T) x) @ T`."""
    return T.adjoint()


def rotation_matrix(T: jaxlie.SE3) -> Float[Array, "*b 3 3"]:
    """Rotation part, 3 x 3."""
    return matrix(T)[..., :3, :3]


def transform(T_a_b: jaxlie.SE3, points: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
    """Points given in frame b, in frame a. One motion, any number of points."""
    rotation = rotation_matrix(T_a_b)
    return jnp.einsum("ij,...j->...i", rotation, points) + T_a_b.wxyz_xyz[4:]


def from_matrix(matrix: Float[np.ndarray, "4 4"], dtype: jnp.dtype | type = jnp.float32) -> jaxlie.SE3:
    """Motion of a homogeneous matrix held on the host."""
    wxyz = quaternions_from_rotations(matrix[None, :3, :3])[0]
    return jaxlie.SE3(jnp.asarray(np.concatenate([wxyz, matrix[:3, 3]]), dtype))


def to_matrices(poses: jaxlie.SE3) -> Float[np.ndarray, "n 4 4"]:
    """Homogeneous matrices, float64 on the host, of a batch of n motions."""
    return matrices_of(np.asarray(poses.wxyz_xyz))


def matrices_of(parameters: Float[np.ndarray, "n 7"]) -> Float[np.ndarray, "n 4 4"]:
    """The same of their parameters wxyz_xyz, without a device."""
    parameters = np.asarray(parameters, np.float64)
    matrices = np.tile(np.eye(4), (len(parameters), 1, 1))
    matrices[:, :3, :3] = rotations_from_quaternions(parameters[:, :4])
    matrices[:, :3, 3] = parameters[:, 4:]
    return matrices


@_promoting
def quaternions(rotations: Float[Array, "n 3 3"]) -> Float[Array, "n 4"]:
    """Unit quaternions wxyz of rotation matrices."""
    return jax.vmap(lambda rotation: jaxlie.SO3.from_matrix(rotation).wxyz)(rotations)
