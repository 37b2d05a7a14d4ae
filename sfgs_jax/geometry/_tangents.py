"""Derivative of the logarithm of a rigid motion, accurate in float32 at every angle."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from sfgs_jax.arrays import checked, dot


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
    v, w = tangent[:3], tangent[3:]
    t, across = dot(w, w), dot(v, w)
    small = t < 1
    series = jnp.where(small, t, 0)
    c_series = 1 / 12 - series**2 / 30240 - series**3 / 604800 - series**4 / 15966720
    e_series = -1 / 720 - series / 15120 - series**2 / 403200 - series**3 / 11975040
    square = jnp.where(small, 1, t)
    angle = jnp.sqrt(square)
    sine, below = angle * jnp.sin(angle), 4 * jnp.minimum(jnp.cos(angle) - 1, -1e-12)
    over = 1 / (square * below)
    c_closed, e_closed = (2 * below + square + 3 * sine) * over, (below + square + sine) * over / square
    c, e = jnp.where(small, c_series, c_closed), jnp.where(small, e_series, e_closed)

    # The blocks of a² and a⁴ are sums of outer products of v and w, and of identities.
    one = jnp.eye(3, dtype=tangent.dtype)[:, :, None]
    mixed = v[:, None] * w[None] + w[:, None] * v[None]
    squared = w[:, None] * w[None]
    c, e, t, across = (x[None, None] for x in (c, e, t, across))
    f = c - e * t
    rotation = (1 - f * t) * one + skew(w) / 2 + f * squared
    coupling = across * (4 * e * t - 2 * c) * one + skew(v) / 2 + f * mixed - 2 * e * across * squared
    return jnp.concatenate(
        [
            jnp.concatenate([rotation, coupling], axis=1),
            jnp.concatenate([jnp.zeros_like(coupling), rotation], axis=1),
        ]
    )
