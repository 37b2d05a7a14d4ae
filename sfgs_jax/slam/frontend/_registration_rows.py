"""Residuals of a registration at its motion, whitened and with their derivatives by the pose.

A registration leaves unknowns out, such as the times of the rows or the scale of depth. Whoever asks for one
of them adds its columns.
"""

import equinox as eqx
import jax.numpy as jnp
import jaxlie
from jax import lax
from jaxtyping import Array, Float

from sfgs_jax import gicp
from sfgs_jax.arrays import dot
from sfgs_jax.geometry import ReprojectionResiduals, kernel_weight, reprojection_residuals, se3
from sfgs_jax.sensors import carried, row_places
from sfgs_jax.slam.config import FeaturesConfig
from sfgs_jax.slam.frontend._target_noise import target_noise, whitened, with_target_noise
from sfgs_jax.slam.state._frame_features import FrameFeatures
from sfgs_jax.slam.state._registration import FeatureRegistration
from sfgs_jax.slam.state._tracker import TrackerParams

_DECIMATION = 2
"""Every second row and column of the points aligned: neighbours share most of their pixels."""


class SurfaceRows(eqx.Module):
    """Distances between two surfaces along their normals, of a sample of the finest level.

    Attributes:
        points: (3, N) of the source, metres.
        targets: (3, N) points of the target that they lie on, in the source's camera.
        normals: (3, N) between the two surfaces' normals, unit vectors.
        residual: (N,) metres.
        pose: (6, N) derivative by the tangent of T_target_source.
        variance: (N,) of the residual as it is expected, m².
        expected_weight: (N,) of independent measurements with that variance, 1/m²; 0 where there is no
            target.
    """

    points: Float[Array, "3 N"]
    targets: Float[Array, "3 N"]
    normals: Float[Array, "3 N"]
    residual: Float[Array, " N"]
    pose: Float[Array, "6 N"]
    variance: Float[Array, " N"]
    expected_weight: Float[Array, " N"]

    @property
    def weight(self) -> Float[Array, " N"]:
        """(N,) of independent measurements, 1/m², the less the more the residuals exceed what is expected."""
        return self.expected_weight / jnp.maximum(self.excess(self.expected_weight), 1)

    def excess(self, weight: Float[Array, " N"]) -> Float[Array, ""]:
        """Variance of the weighted residuals over what is expected."""
        expected = jnp.sum(weight * self.variance)
        return jnp.sum(weight * self.residual**2) / jnp.maximum(expected, 1e-12)


class KeypointRows(eqx.Module):
    """Reprojection errors of the matches that a motion by keypoints explains.

    Attributes:
        points: (3, K) of the target in the source's camera, metres.
        at: residuals and derivatives.
        by_measured: (3, K) derivative of the residuals by the inverse depth that the source measured.
        weight: (K,) of independent measurements; 0 where there is no such match.
    """

    points: Float[Array, "3 K"]
    at: ReprojectionResiduals
    by_measured: Float[Array, "3 K"]
    weight: Float[Array, " K"]

    @property
    def residual(self) -> Float[Array, " rows"]:
        """The residuals, row after row of the image's two and inverse depth."""
        return self.at.residual.reshape(-1)

    @property
    def pose(self) -> Float[Array, "6 rows"]:
        """Derivative of the residuals by the tangent of T_target_source."""
        return jnp.moveaxis(self.at.pose_jacobian, 1, 0).reshape(6, -1)

    @property
    def weights(self) -> Float[Array, " rows"]:
        """Weights of the residuals."""
        return jnp.tile(self.weight, 3)

    def by_points(self, rates: Float[Array, "3 K"]) -> Float[Array, " rows"]:
        """Derivative of the residuals by something that moves the points.

        Args:
            rates: (3, K) derivatives of the points.
        """
        return jnp.sum(self.at.point_jacobian * rates[None], axis=1).reshape(-1)


def surface_rows(
    params: TrackerParams,
    source: FrameFeatures,
    target: FrameFeatures,
    T_target_source: jaxlie.SE3,
    moving: gicp.RowMotion | None = None,
) -> SurfaceRows:
    """Rows by the surface.

    Args:
        params: parameters of tracking.
        source: the frame that was registered.
        target: the frame that it was registered to, rectified.
        T_target_source: the motion.
        moving: motion of the source while it was read; None where it stood still or is rectified.
    """
    clouds = source.cloud.levels, target.cloud.levels
    problem = gicp.level_problem(
        *clouds, None, 0, params.config.gicp, noise=params.noise.surface, decimation=_DECIMATION
    )
    problem = problem if moving is None else problem.with_moving_rows(moving)
    pairs, points = problem.correspondences(T_target_source), problem.source.points
    mean = problem.source.normals + pairs.normals
    normals = mean * lax.rsqrt(jnp.where(pairs.valid, dot(mean, mean), 1))[None]
    residual = jnp.where(pairs.valid, dot(points - pairs.points, normals), 0)
    return SurfaceRows(
        points=points,
        targets=pairs.points,
        normals=normals,
        residual=residual,
        pose=se3.plane_jacobian(points, normals),
        variance=pairs.variance,
        expected_weight=problem.robust_weights(pairs) / problem.redundancy,
    )


def keypoint_rows(
    params: TrackerParams,
    source: FrameFeatures,
    target: FrameFeatures,
    T_target_source: jaxlie.SE3,
    matched: FeatureRegistration,
    moving: gicp.RowMotion | None = None,
) -> KeypointRows:
    """Rows by the keypoints.

    Args:
        params: parameters of tracking.
        source: the frame that was registered; its keypoints' depth is that of colour's time.
        target: the frame that it was registered to, rectified.
        T_target_source: the motion.
        matched: the matches.
        moving: motion of the source while it was read; None where it stood still or is rectified.
    """
    camera, config = params.camera, params.config.features
    pixels, depth = matched.pixels, source.keypoints.depth
    ahead = jnp.asarray([0, 0, 1], pixels.dtype)
    in_target = jnp.where(matched.inliers[:, None], target.keypoints.points[matched.index], ahead)
    points = se3.transform(se3.inverse(T_target_source), in_target).T
    points = jnp.where(matched.inliers[None], points, ahead[:, None])
    seen = points
    if moving is not None:
        times = moving.timing.colour_times(row_places(pixels[:, 1], camera.height))
        seen = carried(points, moving.twist, -times)
    at = reprojection_residuals(
        camera,
        seen,
        pixels.T,
        depth,
        sigma=params.noise.pixels,
        inverse_depth_sigma=params.noise.inverse_depth,
    )
    w = target_noise(T_target_source, in_target, at, params.noise.inverse_depth)
    at = with_target_noise(at, w)
    measured, zero = jnp.where(depth > 0, -1 / params.noise.inverse_depth, 0), jnp.zeros_like(depth)
    by_measured = whitened(jnp.stack([zero, zero, measured])[:, None], w)[:, 0]
    return KeypointRows(points, at, by_measured, _weights(at, matched, config))


def _weights(
    at: ReprojectionResiduals, matched: FeatureRegistration, config: FeaturesConfig
) -> Float[Array, " K"]:
    square = jnp.sum(at.residual**2, axis=0)
    robust = kernel_weight(square, "geman_mcclure", config.matched_kernel_width)
    weight = jnp.where(matched.inliers & at.has_image, robust, 0)
    excess = jnp.sum(weight * square) / jnp.maximum(3 * jnp.sum(weight), 1)
    return weight / (config.correlation * jnp.maximum(excess, 1))
