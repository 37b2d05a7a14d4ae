"""The covariance that a view would give the camera's pose, predicted from a map before the view is taken.

The map is rendered at the pose. Instead of a colour each Gaussian has the information about the pose that a
pixel of its surface gives. The sum over the image is the surface's. It is smooth in the pose, for a Gaussian
enters and leaves the image by and by. Landmarks add the information of a pixel and an inverse
depth. The covariance of the pose follows from a factor graph. All of it is differentiable by the pose.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Bool, Float

from sfgs_jax import factor_graph, splatting
from sfgs_jax.geometry import Camera, se3
from sfgs_jax.slam import TrackingConfig

REACH = 2.0
"""Distance of the points whose displacement sums up an error of a pose, metres."""
EDGE_PIXELS = 2.0
"""Width of the border of the image over which landmarks come into view."""
PRIOR_SIGMA = 0.1
"""Standard deviation of a pose before any view, metres and radians."""
TRACKING = TrackingConfig()
_UPPER = np.triu_indices(6)


class KnownPlace(NamedTuple):
    """Map of a place that was scanned before.

    Attributes:
        gaussians: its surface.
        landmarks: (N, 3) keypoints of the scan, world coordinates, metres.
        share: keypoints of a view, as a share of the landmarks within its image: a scan sees each repeatedly.
        detail: pixels of a view, along a row, for each pixel of a predicted image.
    """

    gaussians: splatting.Gaussians
    landmarks: Float[Array, "N 3"]
    share: Float[Array, ""]
    detail: Float[Array, ""]


def displacement(covariance: Float[Array, "6 6"]) -> Float[Array, ""]:
    """Root mean square displacement of points all around at a distance of `REACH`, metres.

    Args:
        covariance: of a pose's tangent, translation first, metres and radians.
    """
    diagonal = jnp.diagonal(covariance)
    return jnp.sqrt(jnp.sum(diagonal[:3]) + 2 / 3 * REACH**2 * jnp.sum(diagonal[3:]))


def predicted_covariance(
    place: KnownPlace, camera: Camera, T_world_cam: jaxlie.SE3, config: splatting.RenderConfig
) -> Float[Array, "6 6"]:
    """Covariance of the pose that a view from there would have.

    Args:
        place: the place.
        camera: intrinsics of the predicted image, which may be small.
        T_world_cam: the pose.
        config: of the renderer.
    """
    information, depth = surface_information(place, camera, T_world_cam, config)
    points = se3.transform(se3.inverse(T_world_cam), place.landmarks)
    front = points[:, 2] > 0.2
    # A landmark behind the camera has no image. It weighs nothing, wherever it is put.
    points = jnp.where(front[:, None], points, jnp.asarray([[0.0, 0.0, 1.0]]))
    still = jaxlie.SE3(se3.identity().wxyz_xyz[None])
    known = information + jnp.eye(6) / PRIOR_SIGMA**2
    factors = [
        factor_graph.PosePrior(np.asarray([0]), still, known),
        _landmark_factors(place, points, front, depth, camera),
    ]
    graph = factor_graph.FactorGraph(
        factors,
        num_poses=1,
        num_landmarks=len(place.landmarks),
        free_landmarks=np.zeros(len(place.landmarks), bool),
    )
    values = factor_graph.Values(still, points)
    return factor_graph.marginal_covariances(graph, values, poses=np.asarray([0])).poses[0]


def surface_information(
    place: KnownPlace, camera: Camera, T_world_cam: jaxlie.SE3, config: splatting.RenderConfig
) -> tuple[Float[Array, "6 6"], Float[Array, "H W"]]:
    """Information of the distances along the surface's normals, and the depth of the image in metres.

    A pixel's distance has the noise of GICP's settings; windows of neighbours share most of their depths.

    Args:
        place: the place.
        camera: intrinsics of the predicted image.
        T_world_cam: the pose.
        config: of the renderer.
    """
    gicp, gaussians = TRACKING.gicp, place.gaussians
    normals = splatting.camera_normals(gaussians, T_world_cam)
    points = se3.transform(se3.inverse(T_world_cam), gaussians.means)
    rows = jnp.concatenate([normals, jnp.cross(points, normals)], axis=1)
    sigma = gicp.noise + gicp.noise_per_square_metre * points[:, 2] ** 2
    rows = rows / sigma[:, None]
    entries = rows[:, _UPPER[0]] * rows[:, _UPPER[1]]
    drawn = splatting.render(gaussians, camera, T_world_cam, features=entries, config=config)
    assert drawn.features is not None
    total = jnp.sum(drawn.features, axis=(0, 1)) * (place.detail / (2 * gicp.radius + 1)) ** 2
    upper = jnp.zeros((6, 6), total.dtype).at[_UPPER].set(total)
    return upper + jnp.triu(upper, 1).T, drawn.depth


def _landmark_factors(
    place: KnownPlace,
    points: Float[Array, "N 3"],
    front: Bool[Array, " N"],
    depth: Float[Array, "H W"],
    camera: Camera,
) -> factor_graph.RgbdReprojection:
    """A pixel and an inverse depth for each landmark; those out of view or hidden hardly weigh."""
    features = TRACKING.features
    pixels, z = camera.project(points), points[:, 2]
    last = jnp.asarray([[camera.width - 1.0, camera.height - 1.0]])
    margins = jnp.concatenate([pixels, last - pixels], axis=1)
    inside = jnp.prod(jax.nn.sigmoid(margins / EDGE_PIXELS), axis=1)
    at = jnp.clip(jnp.round(pixels), 0, last).astype(jnp.int32)
    hidden = z > 1.05 * depth[at[:, 1], at[:, 0]] + 0.02
    weight = jnp.where(front & ~hidden, inside, 0) * place.share / features.correlation
    spread = jax.lax.rsqrt(jnp.maximum(weight, 1e-12))
    rows = np.arange(len(points))
    return factor_graph.RgbdReprojection(
        np.zeros_like(rows),
        rows,
        pixels,
        z,
        camera,
        sigma=features.pixel_sigma / place.detail * spread,
        inverse_depth_sigma=features.inverse_depth_sigma * spread,
    )
