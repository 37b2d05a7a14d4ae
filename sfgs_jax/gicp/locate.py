"""Where an alignment settles, and how that place moves with the clouds.

The motion found makes the gradient of the frozen normal equations vanish, g(T, clouds) = 0. By the implicit
function theorem it moves with the clouds by -(dg/dT)^-1 dg/dclouds. One Newton step with the exact
dg/dT, from the motion found and at the correspondences found there, has that derivative.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Bool, Int

from sfgs_jax.gicp.config import GicpConfig
from sfgs_jax.gicp.level import Levels, level_problem
from sfgs_jax.gicp.prior import MotionPrior


class Located(eqx.Module):
    """Where an alignment stopped.

    Attributes:
        T_target_source: motion between the levels' coordinates.
        iterations: steps over all levels.
        settled: whether the last step at the finest level was short.
    """

    T_target_source: jaxlie.SE3
    iterations: Int[Array, ""]
    settled: Bool[Array, ""]


def locate(
    source: Levels,
    target: Levels,
    T: jaxlie.SE3,
    prior: MotionPrior | None,
    coarsest: Int[Array, ""],
    config: GicpConfig,
) -> Located:
    """Align from the level `coarsest` to the finest, 0; a cloud with fewer levels repeats its coarsest."""
    return Located(*_locate((source, target, T, prior, coarsest), config=config))


_Inputs = tuple[Levels, Levels, jaxlie.SE3, MotionPrior | None, Int[Array, ""]]

_Outputs = tuple[jaxlie.SE3, Int[Array, ""], Bool[Array, ""]]


@eqx.filter_custom_jvp
def _locate(inputs: _Inputs, *, config: GicpConfig) -> _Outputs:
    source, target, T, prior, coarsest = inputs
    total, settled = jnp.asarray(0), jnp.asarray(False)
    for i in reversed(range(max(len(source), len(target)))):
        problem = level_problem(source, target, prior, i, config)
        T, iterations, settled = problem.minimise(T, i > coarsest)
        total += iterations
    return T, total, settled


@_locate.def_jvp
def _locate_jvp(primals: tuple[_Inputs], tangents: Any, *, config: GicpConfig) -> tuple[_Outputs, Any]:
    (inputs,), (rates,) = primals, tangents
    found = _locate(inputs, config=config)

    def corrected(moving: _Inputs) -> jaxlie.SE3:
        source, target, _, prior, _ = moving
        return level_problem(source, target, prior, 0, config).corrected(found[0])

    _, rate = eqx.filter_jvp(corrected, (inputs,), (rates,))
    return found, (rate, None, None)
