"""Colour that depends on the viewing direction, by real spherical harmonics."""

import math
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sfgs_jax.arrays import InputError, checked

Values = TypeVar("Values", Array, np.ndarray)

_C0 = 0.5 / math.sqrt(math.pi)
_C1 = math.sqrt(3 / (4 * math.pi))
_C2 = (
    math.sqrt(15 / (4 * math.pi)),
    math.sqrt(5 / (16 * math.pi)),
    math.sqrt(15 / (16 * math.pi)),
)
_C3 = (
    math.sqrt(35 / (32 * math.pi)),
    math.sqrt(105 / (4 * math.pi)),
    math.sqrt(21 / (32 * math.pi)),
    math.sqrt(7 / (16 * math.pi)),
    math.sqrt(105 / (16 * math.pi)),
)


@checked
def rgb_to_sh(rgb: Float[Values, "*n 3"]) -> Float[Values, "*n 3"]:
    """Coefficients of degree 0 whose colour is `rgb` from everywhere."""
    return (rgb - 0.5) / _C0


@checked
def sh_to_rgb(sh: Float[Values, "*n 3"]) -> Float[Values, "*n 3"]:
    """RGB, not clipped, of coefficients of degree 0: the inverse of `rgb_to_sh`."""
    return 0.5 + _C0 * sh


def sh_basis(directions: Float[Array, "n 3"], coefficients: int) -> Float[Array, "n {coefficients}"]:
    """Real spherical harmonics at unit directions, in the order and with the signs of 3DGS.

    Args:
        directions: (N, 3) unit vectors.
        coefficients: how many, from degree 0 on: 1, 4, 9 or 16.

    Source: Sloan, Efficient spherical harmonic evaluation, 2013; signs as Kerbl et al. 2023.
    """
    x, y, z = directions[:, 0], directions[:, 1], directions[:, 2]
    basis = [jnp.full_like(x, _C0)]
    if coefficients >= 4:
        basis += [-_C1 * y, _C1 * z, -_C1 * x]
    if coefficients >= 9:
        a, b, c = _C2
        basis += [a * x * y, -a * y * z, b * (2 * z * z - x * x - y * y), -a * x * z, c * (x * x - y * y)]
    if coefficients >= 16:
        a, b, c, d, e = _C3
        basis += [
            -a * y * (3 * x * x - y * y),
            b * x * y * z,
            -c * y * (4 * z * z - x * x - y * y),
            d * z * (2 * z * z - 3 * x * x - 3 * y * y),
            -c * x * (4 * z * z - x * x - y * y),
            e * z * (x * x - y * y),
            -a * x * (x * x - 3 * y * y),
        ]
    return jnp.stack(basis, axis=-1)


def sh_colours(sh: Float[Array, "n k 3"], offsets: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
    """RGB, not below 0, of Gaussians seen from a camera.

    Args:
        sh: (N, K, 3) coefficients.
        offsets: (N, 3) centres minus the camera's, of any length above 0.

    Raises:
        InputError: K is not 1, 4, 9 or 16.
    """
    k = sh.shape[1]
    if k not in (1, 4, 9, 16):
        raise InputError(f"sh has {k} coefficients a channel; degrees 0 to 3 have 1, 4, 9 or 16.")
    if k == 1:
        return jnp.maximum(0.5 + _C0 * sh[:, 0], 0)
    directions = offsets / jnp.linalg.norm(offsets, axis=-1, keepdims=True)
    # The default precision of recent GPUs would shift a colour by a quarter of an 8-bit step.
    sums = jnp.einsum("nk,nkc->nc", sh_basis(directions, k), sh, precision=jax.lax.Precision.HIGHEST)
    return jnp.maximum(0.5 + sums, 0)
