"""Coarse-to-fine alignment of clouds."""

from functools import partial

import jax
import jax.numpy as jnp
import jaxlie
from jax import lax
from jaxtyping import Array, Int

from sfgs_jax.geometry import InputError
from sfgs_jax.gicp.assess import assess
from sfgs_jax.gicp.cloud import OrganisedCloud
from sfgs_jax.gicp.config import GicpConfig
from sfgs_jax.gicp.frames import Frames
from sfgs_jax.gicp.level import level_problem
from sfgs_jax.gicp.locate import locate
from sfgs_jax.gicp.point_cloud import PointCloud
from sfgs_jax.gicp.prior import MotionPrior
from sfgs_jax.gicp.result import RegistrationResult

Cloud = OrganisedCloud | PointCloud


def align(
    source: Cloud,
    target: Cloud,
    init_T_target_source: jaxlie.SE3,
    *,
    prior: MotionPrior | None = None,
    coarsest: int | Int[Array, ""] | None = None,
    config: GicpConfig | None = None,
) -> RegistrationResult:
    """Motion that lays the source on the target, from a start near it.

    Gauss-Newton or Levenberg-Marquardt from the coarsest level to the finest, with projective correspondences
    in an organised target and nearest neighbours in an unorganised one. Correspondences and weights are
    frozen in each step, as in Segal et al., Generalized-ICP (RSS 2009). No step goes in a direction that the
    geometry leaves free; the result names those.

    `T_target_source` is differentiable with respect to everything in the clouds and the prior, by the
    implicit function theorem at the correspondences found (see `locate`). Its derivative with respect to the
    start is 0, and nothing else in the result has one.

    Args:
        source: cloud of the frame to locate, from `prepare` or `prepare_points`.
        target: cloud of the frame to locate it in, from the same or from `prepare_gaussians`.
        init_T_target_source: where to start.
        prior: what is known of the motion beforehand, weighed against the residuals by their noise.
        coarsest: level to begin with, counted from 0, the finest; all levels if not given. A start that is
            good to a few centimetres needs no coarse ones. A new value does not compile anew.
        config: settings, `GicpConfig()` if not given.

    Raises:
        InputError: the levels of organised clouds don't match the config.
    """
    config = GicpConfig() if config is None else config
    for name, cloud in (("source", source), ("target", target)):
        counts = len(cloud.levels), len(config.strides), len(config.max_iterations)
        if isinstance(cloud, OrganisedCloud) and set(counts) != {config.levels}:
            raise InputError(
                f"The {name} has {counts[0]} levels, the config {config.levels} with {counts[1]} strides and "
                f"{counts[2]} iteration limits; prepare both clouds with this config."
            )
    levels = max(len(source.levels), len(target.levels))
    begin = jnp.asarray(levels - 1 if coarsest is None else coarsest, jnp.int32)
    return _align(source, target, init_T_target_source, prior, jnp.maximum(begin, 0), config)


@partial(jax.jit, static_argnames="config")
def _align(
    source: Cloud,
    target: Cloud,
    T: jaxlie.SE3,
    prior: MotionPrior | None,
    coarsest: Int[Array, ""],
    config: GicpConfig,
) -> RegistrationResult:
    frames = Frames(_origin(source), _origin(target))
    centred_prior = None if prior is None else frames.centred_prior(prior)
    found = locate(source.levels, target.levels, frames.centred(T), centred_prior, coarsest, config)
    # Nothing but the motion has derivatives: those of eigenvectors that are not unique would be NaN.
    finest = level_problem(source.levels, target.levels, None, 0, config, judged=True)
    result = assess(*lax.stop_gradient((finest, found)), config)
    return RegistrationResult(
        frames.given(found.T_target_source),
        frames.given_information(result.information),
        result.rmse,
        result.inlier_fraction,
        result.overlap,
        result.iterations,
        result.converged,
        result.observability,
        frames.given_tangents(result.directions),
        result.free,
    )


def _origin(cloud: Cloud) -> jax.Array:
    if isinstance(cloud, PointCloud):
        return cloud.origin
    return jnp.zeros(3, cloud.levels[0].points.dtype)
