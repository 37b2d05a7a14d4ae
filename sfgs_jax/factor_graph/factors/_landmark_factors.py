"""Landmark factors: a landmark seen at a pixel, with or without depth, from a camera pose."""

from abc import abstractmethod

import jax
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, ArrayLike, Float, PyTree

from sfgs_jax.arrays import apply_transposed, multiply
from sfgs_jax.factor_graph._values import Values
from sfgs_jax.factor_graph.factors._arguments import Indices, Mask, PerRow, Scalar, as_indices, check_shape
from sfgs_jax.factor_graph.factors._factor import Factor, Linearised
from sfgs_jax.geometry import Camera, Kernel, ReprojectionResiduals, reprojection_residuals, se3


class _Observation(Factor):
    """Rows that see a landmark at a pixel: the common part of both kinds.

    `reprojection_residuals` computes residuals and Jacobians, and has the rule for landmarks behind the
    camera.
    """

    pixels: Float[Array, "N 2"]
    sigma: Float[Array, " N"]
    camera: Camera

    def _set_pixels(
        self,
        poses: Indices,
        landmarks: Indices,
        pixels: Float[ArrayLike, "N 2"],
        camera: Camera,
        sigma: PerRow,
        valid: Mask | None,
        kernel: Kernel,
        width: Scalar,
    ) -> None:
        kind = type(self).__name__
        indices = as_indices(kind, "poses", poses)
        check_shape(kind, "poses", indices, (indices.size,))
        self._set_rows(indices[:, None], landmarks, valid, kernel, width)
        self._check_rows("pixels", pixels, (2,))
        self.pixels = jnp.asarray(pixels)
        self.sigma = self._by_row("sigma", sigma)
        self.camera = jax.tree.map(lambda x: x.astype(self.pixels.dtype), camera)

    def _by_row(self, name: str, given: PerRow) -> Float[Array, " N"]:
        count = len(self.poses)
        check_shape(type(self).__name__, name, given, (), (count,))
        return jnp.broadcast_to(jnp.asarray(given, self.pixels.dtype), (count,))

    def residual(
        self, row: PyTree, poses: jaxlie.SE3, landmark: Float[Array, "3"] | None
    ) -> Float[Array, " R"]:
        """Predicted minus measured."""
        assert landmark is not None
        point = se3.transform(se3.inverse(jaxlie.SE3(poses.wxyz_xyz[0])), landmark)
        return self._project(point[:, None], tuple(r[..., None] for r in row)).residual[:, 0]

    def residuals(self, values: Values) -> tuple[Float[Array, "R N"], None]:
        """Closed form."""
        rows, (_, points) = self._rows(), self._camera_points(values)
        return self._project(points, rows).residual, None

    def linearise(self, values: Values) -> Linearised:
        """Closed form."""
        rows, (rotation, points) = self._rows(), self._camera_points(values)
        found = self._project(points, rows)
        # The landmark's derivative in the camera is R^T.
        at_landmark = multiply(found.point_jacobian, jnp.swapaxes(rotation, 0, 1))
        return Linearised(found.residual, found.pose_jacobian, at_landmark, None)

    def _rows(self) -> tuple[Float[Array, "..."], ...]:
        return tuple(jnp.moveaxis(r, 0, -1) for r in self.clean_measurements())

    def _camera_points(self, values: Values) -> tuple[Float[Array, "3 3 N"], Float[Array, "3 N"]]:
        """Rotations of the cameras, and the landmarks in camera coordinates."""
        valid = jnp.asarray(self.valid)
        pose = jnp.where(valid, jnp.asarray(self.poses)[:, 0], 0)
        assert self.landmarks is not None
        landmark = jnp.where(valid, jnp.asarray(self.landmarks), 0)
        # Gathered as components with the lanes last: the arithmetic below then runs along the lanes.
        matrices = jnp.transpose(se3.matrix(values.poses)[:, :3], (1, 2, 0))[:, :, pose]
        offset = values.landmarks.T[:, landmark] - matrices[:, 3]
        rotation = matrices[:, :3]
        return rotation, apply_transposed(rotation, offset)

    @abstractmethod
    def _project(
        self, points: Float[Array, "3 N"], rows: tuple[Float[Array, "..."], ...]
    ) -> ReprojectionResiduals:
        """Residuals of points in the camera, given measurements with the lanes last."""


class Reprojection(_Observation):
    """Landmarks seen at pixels: residual (projection - pixel) / sigma, 2 rows.

    Attributes:
        pixels: (N, 2) measured (u, v).
        sigma: (N,) standard deviation, pixels.
        camera: intrinsics of all rows.
    """

    def __init__(
        self,
        poses: Indices,
        landmarks: Indices,
        pixels: Float[ArrayLike, "N 2"],
        camera: Camera,
        *,
        sigma: PerRow = 1.0,
        valid: Mask | None = None,
        kernel: Kernel = "none",
        kernel_width: Scalar = 1.0,
    ):
        """N observations.

        Args:
            poses: (N,) indices of the camera poses.
            landmarks: (N,) indices of the landmarks that they see.
            pixels: (N, 2) measured (u, v).
            camera: intrinsics.
            sigma: (N,) or scalar standard deviation, pixels.
            valid: (N,) rows that count, all if not given.
            kernel: robust kernel.
            kernel_width: its width in standard deviations.

        Raises:
            InputError: an array without one row for each factor.
        """
        self._set_pixels(poses, landmarks, pixels, camera, sigma, valid, kernel, kernel_width)

    def measurements(self) -> PyTree:
        """Pixels and their deviations."""
        return self.pixels, self.sigma

    def _project(
        self, points: Float[Array, "3 N"], rows: tuple[Float[Array, "..."], ...]
    ) -> ReprojectionResiduals:
        pixels, sigma = rows
        return reprojection_residuals(self.camera, points, pixels, sigma=sigma)


class RgbdReprojection(_Observation):
    """Landmarks seen at pixels with depth: 3 rows, the third (1 / z - 1 / depth) / sigma.

    Stereo and structured light measure inverse depth with constant noise. A row without depth (0 or not
    finite) is a plain `Reprojection`.

    Attributes:
        pixels: (N, 2) measured (u, v).
        depth: (N,) measured depth, metres along z.
        sigma: (N,) standard deviation, pixels.
        inverse_depth_sigma: (N,) standard deviation of inverse depth, 1 / m.
        camera: intrinsics of all rows.
    """

    depth: Float[Array, " N"]
    inverse_depth_sigma: Float[Array, " N"]

    def __init__(
        self,
        poses: Indices,
        landmarks: Indices,
        pixels: Float[ArrayLike, "N 2"],
        depth: Float[ArrayLike, " N"],
        camera: Camera,
        *,
        sigma: PerRow = 1.0,
        inverse_depth_sigma: PerRow = 0.003,
        valid: Mask | None = None,
        kernel: Kernel = "none",
        kernel_width: Scalar = 1.0,
    ):
        """N observations.

        Args:
            poses: (N,) indices of the camera poses.
            landmarks: (N,) indices of the landmarks that they see.
            pixels: (N, 2) measured (u, v).
            depth: (N,) metres; 0 is missing.
            camera: intrinsics.
            sigma: (N,) or scalar standard deviation, pixels.
            inverse_depth_sigma: (N,) or scalar, 1 / m; noise of 1.5 mm at 1 m and 6 mm at 2 m is 0.0015.
            valid: (N,) rows that count, all if not given.
            kernel: robust kernel.
            kernel_width: its width in standard deviations.

        Raises:
            InputError: an array without one row for each factor.
        """
        self._set_pixels(poses, landmarks, pixels, camera, sigma, valid, kernel, kernel_width)
        self._check_rows("depth", depth, ())
        self.depth = jnp.asarray(depth, self.pixels.dtype)
        self.inverse_depth_sigma = self._by_row("inverse_depth_sigma", inverse_depth_sigma)

    def measurements(self) -> PyTree:
        """Pixels, depths and their deviations."""
        return self.pixels, self.depth, self.sigma, self.inverse_depth_sigma

    def _project(
        self, points: Float[Array, "3 N"], rows: tuple[Float[Array, "..."], ...]
    ) -> ReprojectionResiduals:
        pixels, depth, sigma, depth_sigma = rows
        return reprojection_residuals(
            self.camera, points, pixels, depth, sigma=sigma, inverse_depth_sigma=depth_sigma
        )
