"""Cost of a graph: half the sum of its robust squared whitened residuals."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from sfgs_jax.arrays import checked
from sfgs_jax.factor_graph._values import Values
from sfgs_jax.factor_graph.problem._graph import FactorGraph

Losses = tuple[Float[Array, "..."], ...]
"""Per factor block (N,): robust squared whitened residuals, 0 where masked."""


@checked
def cost(graph: FactorGraph, values: Values) -> Float[Array, ""]:
    """Half the sum of robust squared whitened residuals.

    Args:
        graph: factors.
        values: poses and landmarks.
    """
    return half_sum(all_losses(graph, values), values)


def all_losses(graph: FactorGraph, values: Values) -> Losses:
    """Robust squared whitened residuals of every factor block."""
    return tuple(factor.losses(values) for factor in graph.factors)


def half_sum(losses: Losses, values: Values) -> Float[Array, ""]:
    """Half the sum of losses, in the type of the values."""
    return sum((_staged_sum(x) for x in losses), jnp.zeros((), values.poses.wxyz_xyz.dtype)) / 2


def cost_drop(before: Losses, after: Losses, values: Values) -> Float[Array, ""]:
    """Drop of the cost, as a sum of differences: float32 would round away the difference of two sums."""
    return half_sum(tuple(a - b for a, b in zip(before, after, strict=True)), values)


def _staged_sum(lanes: Float[Array, " N"]) -> Float[Array, ""]:
    """Sum in two stages: rounding errors then grow with the length of a stage, the root of N."""
    size = max(1, int(len(lanes) ** 0.5))
    padded = jnp.pad(lanes, (0, -len(lanes) % size))
    return jnp.sum(jnp.sum(padded.reshape(-1, size), axis=0))
