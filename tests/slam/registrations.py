"""Registrations with made-up evidence."""

import jax.numpy as jnp
import jaxlie

from sfgs_jax.geometry import se3
from sfgs_jax.slam.state import FeatureRegistration, PoseSource, Registration


def registration(
    T: jaxlie.SE3 | None = None,
    *,
    source: PoseSource = PoseSource.JOINT,
    inliers: int = 100,
    fraction: float = 0.7,
) -> Registration:
    """A registration with so many keypoint inliers and such a share of surface inliers."""
    T = se3.identity() if T is None else T
    matched = FeatureRegistration(
        T_target_source=T,
        information=jnp.eye(6),
        index=jnp.zeros(4, int),
        inliers=jnp.zeros(4, bool),
        num_detected=jnp.asarray(2 * inliers),
        num_matches=jnp.asarray(2 * inliers),
        num_inliers=jnp.asarray(inliers),
        pixels=jnp.zeros((4, 2)),
        T_as_detected=T,
    )
    return Registration(
        T_target_source=T,
        surface_information=jnp.eye(6),
        matched=matched,
        source=jnp.asarray(int(source)),
        inlier_fraction=jnp.asarray(fraction),
        agreement=jnp.asarray(1.0),
        rmse=jnp.zeros(()),
        num_free=jnp.asarray(0),
        scale_change=jnp.asarray(0.0),
        scale_sigma=jnp.asarray(0.001),
        image_correlation=jnp.asarray(1.0),
    )
