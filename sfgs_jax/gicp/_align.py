"""Coarse-to-fine alignment of clouds."""

from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.arrays import InputError, checked_but, described
from sfgs_jax.geometry import se3
from sfgs_jax.gicp._assessment import ASSESSMENT_DECIMATION, RegistrationResult, assess
from sfgs_jax.gicp._centred_frames import CentredFrames
from sfgs_jax.gicp._config import GicpConfig
from sfgs_jax.gicp._distance_noise import DistanceNoise
from sfgs_jax.gicp._implicit import newton_corrected
from sfgs_jax.gicp._level_problem import Levels, Minimum, level_problem
from sfgs_jax.gicp._normal_equations import MotionPrior
from sfgs_jax.gicp._sweep import Sweep
from sfgs_jax.gicp.clouds import OrganisedCloud, PointCloud

Cloud = OrganisedCloud | PointCloud

_Inputs = tuple[
    Levels, Levels, jaxlie.SE3, MotionPrior | None, Int[Array, ""], Sweep | None, DistanceNoise | None
]
"""Levels of the source, levels of the target, start, prior, coarsest level, sweep and noise of the source."""
_Outputs = tuple[jaxlie.SE3, Int[Array, ""], Bool[Array, ""]]
"""Fields of a `Minimum`: the rule of a derivative gives None for those that have none."""


@checked_but("source", "target", "init_T_target_source")
def align(
    source: Cloud,
    target: Cloud,
    init_T_target_source: se3.Pose,
    *,
    prior: MotionPrior | None = None,
    coarsest: int | Int[Array, ""] | None = None,
    sweep: Sweep | None = None,
    noise: DistanceNoise | None = None,
    config: GicpConfig | None = None,
) -> RegistrationResult:
    """Motion that lays the source on the target, from a start near it.

    Generalized ICP, by Gauss-Newton or Levenberg-Marquardt from the coarsest level to the finest.
    Correspondences are projective in an organised target, and nearest neighbours in an unorganised one. Each
    step holds them and the weights fixed, as in Segal et al., Generalized-ICP (RSS 2009). No step takes a
    direction that the geometry leaves free; the result names these directions.

    The motion is differentiable with respect to the clouds, the prior and the noise, by the implicit function
    theorem at the correspondences found. Its derivative with respect to the start is 0, and nothing else in
    the result has one.

    Args:
        source: cloud of the frame to locate, from `prepare` or `prepare_points`.
        target: cloud of the frame to locate it in, from the same or from `prepare_gaussians`.
        init_T_target_source: start, `jaxlie.SE3` or a homogeneous 4 x 4 matrix.
        prior: prior of the motion, weighed against the residuals by their noise.
        coarsest: level to begin with, counted from 0, the finest; all levels if not given. A start that is
            good to a few centimetres needs no coarse ones. A new value does not compile anew.
        sweep: motion of the camera while the source was read, for organised sources. Each step renews it,
            and the derivative of the motion heeds that.
        noise: of the source's distances, for organised sources; that of the settings if not given.
        config: settings, `GicpConfig()` if not given.

    Raises:
        InputError: a cloud or the start is none, an organised cloud was prepared with another number of
            levels than the config's, or an unorganised source has a sweep.
    """
    config = GicpConfig() if config is None else config
    start = se3.as_se3(init_T_target_source, name="init_T_target_source")
    for name, cloud in (("source", source), ("target", target)):
        if not isinstance(cloud, OrganisedCloud | PointCloud):
            raise InputError(
                f"The {name} is a cloud from prepare, prepare_points or prepare_gaussians, "
                f"not {described(cloud)}."
            )
        if isinstance(cloud, OrganisedCloud) and len(cloud.levels) != config.levels:
            raise InputError(
                f"The {name} has {len(cloud.levels)} levels, but the config {config.levels}; "
                "prepare both clouds with this config."
            )
    if sweep is not None and not isinstance(source, OrganisedCloud):
        raise InputError("Only a depth image has rows that a sweep could move: leave out `sweep` for points.")
    levels = max(len(source.levels), len(target.levels))
    begin = jnp.asarray(levels - 1 if coarsest is None else coarsest, jnp.int32)
    return _align(source, target, start, prior, jnp.maximum(begin, 0), sweep, noise, config)


@partial(jax.jit, static_argnames="config")
def _align(
    source: Cloud,
    target: Cloud,
    start: jaxlie.SE3,
    prior: MotionPrior | None,
    coarsest: Int[Array, ""],
    sweep: Sweep | None,
    noise: DistanceNoise | None,
    config: GicpConfig,
) -> RegistrationResult:
    frames = CentredFrames(_origin(source), _origin(target))
    prior = None if prior is None else frames.centred_prior(prior)
    inputs = source.levels, target.levels, frames.centred(start), prior, coarsest, sweep, noise
    minimum = Minimum(*_coarse_to_fine(inputs, config=config))
    finest = level_problem(
        *(source.levels, target.levels, None, 0, config),
        sweep=sweep,
        noise=noise,
        decimation=ASSESSMENT_DECIMATION,
    ).at(minimum.T_target_source)
    # Only the motion has derivatives: those of eigenvectors that are not unique would be NaN.
    result = assess(*lax.stop_gradient((finest, minimum)))
    return replace(
        result,
        T_target_source=frames.uncentred(minimum.T_target_source),
        information=frames.uncentred_information(result.information),
        directions=frames.uncentred_tangents(result.directions),
    )


@eqx.filter_custom_jvp
def _coarse_to_fine(inputs: _Inputs, *, config: GicpConfig) -> _Outputs:
    """Minimum of each level in turn, from the coarsest to the finest, as the start of the next."""
    source, target, T, prior, coarsest, sweep, noise = inputs
    iterations, converged = jnp.asarray(0), jnp.asarray(False)
    for index in reversed(range(max(len(source), len(target)))):
        problem = level_problem(source, target, prior, index, config, sweep=sweep, noise=noise)
        minimum = problem.minimise(T, skipped=index > coarsest)
        T, converged = minimum.T_target_source, minimum.converged
        iterations += minimum.iterations
    return T, iterations, converged


@_coarse_to_fine.def_jvp
def _coarse_to_fine_jvp(
    primals: tuple[_Inputs], tangents: Any, *, config: GicpConfig
) -> tuple[_Outputs, Any]:
    """The motion has the derivative of a Newton step at the finest level; the rest has none."""
    (inputs,), (rates,) = primals, tangents
    outputs = _coarse_to_fine(inputs, config=config)

    def corrected(moving: _Inputs) -> jaxlie.SE3:
        source, target, _, prior, _, sweep, noise = moving
        finest = level_problem(source, target, prior, 0, config, sweep=sweep, noise=noise)
        return newton_corrected(finest, outputs[0])

    _, rate = eqx.filter_jvp(corrected, (inputs,), (rates,))
    return outputs, (rate, None, None)


def _origin(cloud: Cloud) -> Float[Array, "3"]:
    if isinstance(cloud, PointCloud):
        return cloud.origin
    return jnp.zeros(3, cloud.levels[0].points.dtype)
