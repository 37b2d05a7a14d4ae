"""A block of factors: rows of one kind with a mask, a robust kernel, and their normal equations."""

from abc import abstractmethod
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jax.lax import Precision
from jaxtyping import Array, ArrayLike, Bool, Float, Int, PyTree, Shaped

from sfgs_jax.arrays import apply, apply_transposed, multiply
from sfgs_jax.factor_graph._values import Values
from sfgs_jax.factor_graph.factors._arguments import (
    Indices,
    Mask,
    Scalar,
    as_indices,
    check_kernel,
    check_shape,
)
from sfgs_jax.geometry import Kernel, kernel_rho, kernel_weight, se3


class Linearised(eqx.Module):
    """Residuals and Jacobians of N rows, lanes last: the rows lie side by side for SIMD.

    Attributes:
        residual: (R, N), unwhitened.
        pose_jacobian: (R, 6 k, N) by the tangents of the k poses of each row.
        landmark_jacobian: (R, 3, N), or None.
        information: (R, R, N), or None for the identity.
    """

    residual: Float[Array, "R N"]
    pose_jacobian: Float[Array, "R d N"]
    landmark_jacobian: Float[Array, "R 3 N"] | None
    information: Float[Array, "R R N"] | None


class Terms(eqx.Module):
    """Contribution of a block to the normal equations H step = -gradient, in M groups of rows.

    Attributes:
        losses: (N,) robust squared whitened residual of each row, 0 where masked; half their sum is the cost.
        pose_hessian: (M, 6 k, 6 k).
        pose_gradient: (M, 6 k).
        landmark_hessian: (M, 3, 3), or None.
        landmark_gradient: (M, 3), or None.
        cross: (M, k, 3, 6) landmark-pose blocks, or None.
    """

    losses: Float[Array, " N"]
    pose_hessian: Float[Array, "M d d"]
    pose_gradient: Float[Array, "M d"]
    landmark_hessian: Float[Array, "M 3 3"] | None = None
    landmark_gradient: Float[Array, "M 3"] | None = None
    cross: Float[Array, "M k 3 6"] | None = None


class Factor(eqx.Module):
    """A block of N factors of one kind.

    A subclass gives `residual` and `measurements`, and may give `information` and a faster `linearise`.
    Rows that are not valid may hold anything, NaN included: a valid row takes their place, and they weigh
    nothing.

    Attributes:
        poses: (N, k) indices of the poses of each row.
        landmarks: (N,) index of the landmark of each row, or None.
        valid: (N,) rows that count.
        kernel: robust kernel of the squared whitened residual of a row; static.
        kernel_width: its width in standard deviations.
        relative: whether the residuals are invariant to a rigid motion of all poses.
    """

    relative: ClassVar[bool] = False
    poses: Int[Array | np.ndarray, "N k"]
    landmarks: Int[Array | np.ndarray, " N"] | None
    valid: Bool[Array | np.ndarray, " N"]
    kernel: Kernel = eqx.field(static=True)
    kernel_width: Float[Array, ""]

    def _set_rows(
        self,
        poses: Int[np.ndarray, "N k"],
        landmarks: Indices | None,
        valid: Mask | None,
        kernel: Kernel,
        kernel_width: Scalar,
    ) -> None:
        """Set the fields that all kinds of factors have; the number of poses' rows is N."""
        kind, count = type(self).__name__, len(poses)
        check_kernel(kind, kernel)
        # Indices stay on the host, where a graph is laid out.
        self.poses = poses
        self.landmarks = None if landmarks is None else as_indices(kind, "landmarks", landmarks)
        self.valid = np.ones(count, bool) if valid is None else np.asarray(valid, bool)
        for name, array in (("landmarks", self.landmarks), ("valid", self.valid)):
            if array is not None:
                check_shape(kind, name, array, (count,))
        check_shape(kind, "kernel_width", kernel_width, ())
        self.kernel = kernel
        self.kernel_width = jnp.asarray(kernel_width, jnp.result_type(float))

    def _check_rows(self, name: str, given: Shaped[ArrayLike, "..."], *shapes: tuple[int, ...]) -> None:
        """Refuse an array without one row of one of these shapes for each factor."""
        rows = [(len(self.poses), *shape) for shape in shapes]
        check_shape(type(self).__name__, name, given, *rows)

    @property
    def groups(self) -> Int[np.ndarray, "M k"]:
        """Poses of each group of rows that adds one block to the normal equations: by default each row."""
        return np.asarray(self.poses)

    @property
    def group_valid(self) -> Bool[np.ndarray, " M"]:
        """Groups that count."""
        return np.asarray(self.valid)

    @abstractmethod
    def measurements(self) -> PyTree:
        """Tree of arrays with N rows; `residual` takes one row of it."""

    @abstractmethod
    def residual(
        self, row: PyTree, poses: jaxlie.SE3, landmark: Float[Array, "3"] | None
    ) -> Float[Array, " R"]:
        """Residual of one row.

        Args:
            row: one row of the measurements.
            poses: (k,) poses of the row.
            landmark: (3,) landmark of the row, or None.
        """

    def information(self, rows: PyTree) -> Float[Array, "N R R"] | None:
        """Information matrices of the residuals, given clean measurements; None for the identity."""
        return None

    def clean_measurements(self) -> PyTree:
        """Measurements with a copy of a valid row in place of each masked one."""
        if not len(self.valid):
            return self.measurements()
        valid = jnp.asarray(self.valid)
        first = jnp.argmax(valid)

        def clean(rows: Array) -> Array:
            rows = jnp.asarray(rows)
            mask = valid.reshape(-1, *[1] * (rows.ndim - 1))
            usable = rows[first]
            if jnp.issubdtype(rows.dtype, jnp.floating):
                usable = jnp.where(valid[first], usable, jnp.ones_like(usable))
            return jnp.where(mask, rows, usable[None])

        return jax.tree.map(clean, self.measurements())

    def gather(self, values: Values) -> tuple[jaxlie.SE3, Float[Array, "N 3"] | None]:
        """Poses (N, k) and landmarks (N, 3) of all rows; masked rows take the first of each."""
        valid = jnp.asarray(self.valid)
        poses = jaxlie.SE3(values.poses.wxyz_xyz[jnp.where(valid[:, None], jnp.asarray(self.poses), 0)])
        if self.landmarks is None:
            return poses, None
        return poses, values.landmarks[jnp.where(valid, jnp.asarray(self.landmarks), 0)]

    def residuals(self, values: Values) -> tuple[Float[Array, "R N"], Float[Array, "R R N"] | None]:
        """Unwhitened residuals and their information, lanes last."""
        rows = self.clean_measurements()
        poses, landmarks = self.gather(values)
        residual = jax.vmap(self.residual, out_axes=-1)(rows, poses, landmarks)
        return residual, _lanes_last(self.information(rows))

    def linearise(self, values: Values) -> Linearised:
        """Residuals with Jacobians by the tangents, by forward differentiation."""
        rows = self.clean_measurements()
        poses, landmarks = self.gather(values)
        k = self.poses.shape[1]

        def perturbed(row: PyTree, T: jaxlie.SE3, x: Array | None, step: Array) -> tuple[Array, Array]:
            moved = se3.compose(T, se3.exp(step[: 6 * k].reshape(k, 6)))
            value = self.residual(row, moved, None if x is None else x + step[6 * k :])
            return value, value

        size = 6 * k + (0 if landmarks is None else 3)
        zero = jnp.zeros(size, values.poses.wxyz_xyz.dtype)
        jacobian, residual = jax.vmap(jax.jacfwd(perturbed, argnums=3, has_aux=True), (0, 0, 0, None), -1)(
            rows, poses, landmarks, zero
        )
        return Linearised(
            residual,
            jacobian[:, : 6 * k],
            None if landmarks is None else jacobian[:, 6 * k :],
            _lanes_last(self.information(rows)),
        )

    def losses(self, values: Values) -> Float[Array, " N"]:
        """Robust squared whitened residual of each row, 0 where masked."""
        square = squared_mahalanobis(*self.residuals(values))
        return jnp.where(jnp.asarray(self.valid), self.robust(square), 0)

    def robust(self, square: Float[Array, " N"]) -> Float[Array, " N"]:
        """`kernel_rho` of this block."""
        return kernel_rho(square, self.kernel, jnp.asarray(self.kernel_width, square.dtype))

    def robust_weight(self, square: Float[Array, " N"]) -> Float[Array, " N"]:
        """`kernel_weight` of this block, 0 where masked."""
        weight = kernel_weight(square, self.kernel, jnp.asarray(self.kernel_width, square.dtype))
        return jnp.where(jnp.asarray(self.valid), weight, 0)

    def terms(self, values: Values) -> Terms:
        """Normal equations of iteratively reweighted least squares, row by row."""
        linear = self.linearise(values)
        information, k = linear.information, self.poses.shape[1]
        r, jacobian = linear.residual, linear.pose_jacobian
        square = squared_mahalanobis(r, information)
        weight = self.robust_weight(square)
        mask = jnp.asarray(self.valid)
        # A masked row may hold what is not finite, and 0 times that is not 0.
        r, jacobian = jnp.where(mask[None], r, 0), jnp.where(mask[None, None], jacobian, 0)

        weighted = _apply_information(information, jacobian) * weight[None, None]
        losses = jnp.where(mask, self.robust(square), 0)
        pose_hessian = _products(jacobian, weighted)
        pose_gradient = apply_transposed(weighted, r).T
        if linear.landmark_jacobian is None:
            return Terms(losses, pose_hessian, pose_gradient)
        at_landmark = jnp.where(mask[None, None], linear.landmark_jacobian, 0)
        weighted_landmark = _apply_information(information, at_landmark) * weight[None, None]
        cross = _products(weighted_landmark, jacobian).reshape(-1, 3, k, 6)
        return Terms(
            losses=losses,
            pose_hessian=pose_hessian,
            pose_gradient=pose_gradient,
            landmark_hessian=_products(at_landmark, weighted_landmark),
            landmark_gradient=apply_transposed(weighted_landmark, r).T,
            cross=jnp.swapaxes(cross, 1, 2),
        )


def squared_mahalanobis(
    residual: Float[Array, "R N"], information: Float[Array, "R R N"] | None
) -> Float[Array, " N"]:
    """Squared Mahalanobis norm r^T Omega r of each row.

    Args:
        residual: (R, N).
        information: (R, R, N) matrices Omega; None for the identity.
    """
    weighed = residual if information is None else apply(information, residual)
    return jnp.sum(residual * weighed, axis=0)


def _apply_information(
    information: Float[Array, "R R N"] | None, jacobian: Float[Array, "R d N"]
) -> Float[Array, "R d N"]:
    return jacobian if information is None else multiply(information, jacobian)


def _lanes_last(matrices: Float[Array, "N R R"] | None) -> Float[Array, "R R N"] | None:
    return None if matrices is None else jnp.moveaxis(matrices, 0, -1)


def _products(a: Float[Array, "r c N"], b: Float[Array, "r d N"]) -> Float[Array, "N c d"]:
    """a^T b, row by row. XLA makes the factors of a product once, those of a transposed sum once an entry."""
    return jnp.einsum("rcn,rdn->ncd", a, b, precision=Precision.HIGHEST)
