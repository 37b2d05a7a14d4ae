"""Equations of the errors of depth after a registration of two keyframes.

A camera's distortion of depth moves with the camera. So two surfaces that a motion lays on each other still
bend against each other, and no other motion removes that. If depth's camera is not where it is taken to be,
the motion that its surfaces tell is not that of colour's keypoints. Each registration has its normal
equations of the pose and of these errors, with the pose eliminated. The errors are the same for all frames,
so the sum of these equations is all there is to keep. The same equations say how the motion changes with
the errors.
"""

from functools import reduce
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import Precision
from jaxtyping import Array, Bool, Float

from sfgs_jax import gicp
from sfgs_jax.geometry import Camera
from sfgs_jax.slam.frontend._depth_derivatives import keypoints_by_depth, surface_by_depth
from sfgs_jax.slam.frontend._registration_rows import keypoint_rows, surface_rows
from sfgs_jax.slam.keyframes._elimination import by_pose, without_pose
from sfgs_jax.slam.state._frame_features import FrameFeatures
from sfgs_jax.slam.state._registration import BY_KEYPOINTS, PoseSource, Registration
from sfgs_jax.slam.state._tracker import TrackerParams

_MIN_FLATNESS = 0.9
"""Least cosine between a point's normal and those two pixels around it. The mean of a window over a crease
lies beside the surface, the more the farther it is. In a room seen without error that looked like one of
4 mm at 2 m, and this threshold leaves 0.1 mm. With noise those from 0.7 to 0.97 leave up to 0.9 mm."""


class ToldOfDepth(NamedTuple):
    """Normal equations of the parameters, with the pose eliminated.

    Attributes:
        information: (G, G).
        vector: (G,) right-hand side, for the difference from the correction in use.
    """

    information: Float[np.ndarray, "G G"]
    vector: Float[np.ndarray, " G"]


class DepthEquations(eqx.Module):
    """A registration's equations of the G parameters of a `DepthCorrection`, on the host.

    Attributes:
        by_surface: what the surfaces alone tell.
        by_both: what surfaces and keypoints tell together, by which alone an extrinsic shows. Where none is
            estimated, the same as by the surfaces.
        sensitivity: (6, G) derivative of the motion's tangent by the parameters.
        surface_sensitivity: (6, G) that of the motion by the surface alone.
    """

    by_surface: ToldOfDepth
    by_both: ToldOfDepth
    sensitivity: Float[np.ndarray, "6 G"]
    surface_sensitivity: Float[np.ndarray, "6 G"]


def depth_equations(
    params: TrackerParams, source: FrameFeatures, target: FrameFeatures, found: Registration
) -> DepthEquations:
    """Equations of the correction's parameters after a registration.

    Args:
        params: parameters of tracking; both frames have its correction.
        source: the frame that was registered.
        target: the frame that it was registered to.
        found: the registration.
    """
    matrices = _normal_matrices(params, source, target, found)
    surface, keypoints, excess = (np.asarray(x, np.float64) for x in matrices)
    kind = int(found.source)
    by_surface, by_keypoints = kind != PoseSource.KEYPOINTS, kind in BY_KEYPOINTS
    # The motion moves as the registration weighs both. Surfaces tell the less, the farther they miss each
    # other. If they miss by less than their noise, they tell no more for it: what is left is no noise, and
    # alike in all pairs.
    weighed = surface * by_surface + keypoints * by_keypoints
    told = surface / np.maximum(excess, 1) * by_surface
    alone = together = _left(told)
    if params.config.estimate_extrinsic:
        together = _left(told + keypoints * by_keypoints)
    return DepthEquations(
        by_surface=alone,
        by_both=together,
        sensitivity=-by_pose(weighed)[:, :-1],
        surface_sensitivity=-by_pose(surface)[:, :-1],
    )


def _left(matrix: Float[np.ndarray, "n n"]) -> ToldOfDepth:
    """Equations of the parameters from a normal matrix of pose, parameters and residual."""
    left = without_pose(matrix)
    return ToldOfDepth(left[:-1, :-1], -left[:-1, -1])


@jax.jit
def _normal_matrices(
    params: TrackerParams, source: FrameFeatures, target: FrameFeatures, found: Registration
) -> tuple[Float[Array, "n n"], Float[Array, "n n"], Float[Array, ""]]:
    """Normal matrices of pose, parameters and residual, n = 6 + G + 1, by surface and by keypoints.

    The last is the variance of the surface's residuals over what is expected of them.
    """
    surface, excess = _surface_rows(params, source, target, found)
    keypoints = _keypoint_rows(params, source, target, found)
    return surface.normal_matrix(), reduce(jnp.add, [rows.normal_matrix() for rows in keypoints]), excess


class _Rows(NamedTuple):
    """Residuals with their derivatives, and their weights. To join them would take longer than the products.

    Attributes:
        pose: (6, N) derivatives by the pose's tangent.
        grid: (R C, N) by the offsets.
        rest: (7, N) by the extrinsic, and the residual.
        weight: (N,); where it is 0, the others may be anything.
    """

    pose: Float[Array, "6 N"]
    grid: Float[Array, "m N"]
    rest: Float[Array, "7 N"]
    weight: Float[Array, " N"]

    def normal_matrix(self) -> Float[Array, "n n"]:
        """Normal matrix of the pose, the parameters and the residual."""
        root = jnp.sqrt(self.weight)[None]
        parts = [jnp.where(root > 0, part * root, 0) for part in (self.pose, self.grid, self.rest)]
        products = [[jnp.matmul(a, b.T, precision=Precision.HIGHEST) for b in parts] for a in parts]
        return jnp.block(products)


def _surface_rows(
    params: TrackerParams, source: FrameFeatures, target: FrameFeatures, found: Registration
) -> tuple[_Rows, Float[Array, ""]]:
    """Distances along the normals of a sample of the finest level; their variance over what is expected."""
    T = found.T_target_source
    rows = surface_rows(params, source, target, T)
    flat = _is_flat(source.cloud.levels[0])
    stride = round((flat.size / len(rows.residual)) ** 0.5)
    weight = jnp.where(flat[::stride, ::stride].reshape(-1), rows.expected_weight, 0)

    by = surface_by_depth(rows, weight, source.cloud.levels[0].camera, T)
    rest = jnp.concatenate([by.extrinsic, rows.residual[None]])
    return _Rows(rows.pose, by.grid, rest, weight), rows.excess(weight)


def _is_flat(level: gicp.OrganisedLevel) -> Bool[Array, "h w"]:
    """True where the surface around a point is flat."""
    normals = jnp.pad(level.normals, ((2, 2), (2, 2), (0, 0)))
    height, width = level.valid.shape
    steps = ((0, 0), (0, 4), (4, 0), (4, 4), (0, 2), (2, 0), (2, 4), (4, 2))
    around = [normals[v : v + height, u : u + width] for v, u in steps]
    least = reduce(jnp.minimum, [jnp.sum(level.normals * n, axis=-1) for n in around])
    return least > _MIN_FLATNESS


def _keypoint_rows(
    params: TrackerParams, source: FrameFeatures, target: FrameFeatures, found: Registration
) -> list[_Rows]:
    """Errors of the matches that the motion explains: along the image's axes, and in inverse depth."""
    T, matched, camera = found.T_target_source, found.matched, params.camera
    rows = keypoint_rows(params, source, target, T, matched)
    target_pixels = target.keypoints.features.keypoints[matched.index]
    # Only where the surface has one normal is it known how an extrinsic changes a keypoint's depth.
    flat = _is_flat_at(source, camera, matched.pixels) & _is_flat_at(target, camera, target_pixels)
    weight = jnp.where(flat, rows.weight, 0)
    return [
        _Rows(pose, by.grid, jnp.concatenate([by.extrinsic, residual[None]]), weight)
        for pose, residual, by in zip(
            rows.at.pose_jacobian,
            rows.at.residual,
            keypoints_by_depth(rows, source, target, matched, camera, T),
            strict=True,
        )
    ]


def _is_flat_at(features: FrameFeatures, camera: Camera, pixels: Float[Array, "k 2"]) -> Bool[Array, " k"]:
    """True where the surface that keypoints lie on is flat."""
    level = features.cloud.levels[0]
    height, width = level.valid.shape
    at = level.camera.project(camera.unproject(pixels, jnp.ones_like(pixels[:, 0])))
    u, v = jnp.round(at).astype(jnp.int32).T
    return _is_flat(level)[jnp.clip(v, 0, height - 1), jnp.clip(u, 0, width - 1)]
