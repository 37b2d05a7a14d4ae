"""Derivative of the logarithm of a rigid motion, accurate in float32 at every angle."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from sfgs_jax.arrays import checked, multiply


@checked
def skew(v: Float[Array, "3 N"]) -> Float[Array, "3 3 N"]:
    """Cross product matrices of N vectors."""
    x, y, z = v
    o = jnp.zeros_like(x)
    return jnp.stack([jnp.stack([o, -z, y]), jnp.stack([z, o, -x]), jnp.stack([-y, x, o])])


@checked
def inverse_right_jacobian(tangent: Float[Array, "6 N"]) -> Float[Array, "6 6 N"]:
    """Inverse right Jacobian J: log(exp(x) exp(d)) = x + J d to first order in d; translation first.

    J = 1 + a / 2 + c a² + e a⁴ with a = ad(x), exact because a (a² + θ²)² = 0. Up to θ = 1, where the closed
    forms of c and e lose their digits, they come from their series in θ².

    Source: Selig, Geometric Fundamentals of Robotics, 2nd ed., section 7.6.
    """
    V, W = skew(tangent[:3]), skew(tangent[3:])
    t = jnp.sum(tangent[3:] ** 2, axis=0)
    small = t < 1
    series = jnp.where(small, t, 0)
    c_series = 1 / 12 - series**2 / 30240 - series**3 / 604800 - series**4 / 15966720
    e_series = -1 / 720 - series / 15120 - series**2 / 403200 - series**3 / 11975040
    square = jnp.where(small, 1, t)
    angle = jnp.sqrt(square)
    sine, below = jnp.sin(angle), 4 * jnp.minimum(jnp.cos(angle) - 1, -1e-12)
    c_closed = 2 / square + (angle + 3 * sine) / (angle * below)
    e_closed = 1 / square**2 + (angle + sine) / (angle * square * below)
    c, e = jnp.where(small, c_series, c_closed), jnp.where(small, e_series, e_closed)

    A = multiply(W, W)
    B = multiply(W, V) + multiply(V, W)
    one = jnp.eye(3, dtype=tangent.dtype)[:, :, None]
    rotation = one + W / 2 + (c - e * t)[None, None] * A
    coupling = V / 2 + c[None, None] * B + e[None, None] * (multiply(A, B) + multiply(B, A))
    return jnp.concatenate(
        [
            jnp.concatenate([rotation, coupling], axis=1),
            jnp.concatenate([jnp.zeros_like(coupling), rotation], axis=1),
        ]
    )
