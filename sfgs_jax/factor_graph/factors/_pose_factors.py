"""Pose factors: priors of poses, and motions measured between two poses."""

from typing import ClassVar

import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Float, Int, PyTree

from sfgs_jax.arrays import multiply
from sfgs_jax.factor_graph._values import Values
from sfgs_jax.factor_graph.factors._arguments import (
    IndexPairs,
    Indices,
    Mask,
    Scalar,
    as_indices,
    check_shape,
)
from sfgs_jax.factor_graph.factors._factor import Factor, Linearised
from sfgs_jax.geometry import Kernel, inverse_right_jacobian, se3


class _MeasuredMotion(Factor):
    """Rows with a measured motion Z, and the information of the residual's tangent."""

    measured: jaxlie.SE3
    matrices: Float[Array, "N 6 6"]

    def _set_motions(
        self,
        poses: Int[np.ndarray, "N k"],
        measured: se3.Pose,
        information: Float[Array, "*n 6 6"],
        valid: Mask | None,
        kernel: Kernel,
        width: Scalar,
    ) -> None:
        self._set_rows(poses, None, valid, kernel, width)
        kind, count = type(self).__name__, len(poses)
        motions = se3.as_se3(measured, name=f"The measured motion of {kind}", axes=None)
        self._check_rows("the motions wxyz_xyz", motions.wxyz_xyz, (7,))
        check_shape(kind, "information", information, (6, 6), (count, 6, 6))
        self.measured = motions
        self.matrices = jnp.broadcast_to(jnp.asarray(information), (count, 6, 6))

    def measurements(self) -> PyTree:
        """Motions and information."""
        return self.measured, self.matrices

    def information(self, rows: PyTree) -> Float[Array, "N 6 6"]:
        """Information as given."""
        return rows[1]


class PosePrior(_MeasuredMotion):
    """Poses known beforehand: residual log(Z^-1 T), 6 rows, translation first.

    Attributes:
        measured: (N,) poses Z.
        matrices: (N, 6, 6) information of the residual's tangent.
    """

    def __init__(
        self,
        poses: Indices,
        T_world_pose: se3.Pose,
        information: Float[Array, "*n 6 6"],
        *,
        valid: Mask | None = None,
        kernel: Kernel = "none",
        kernel_width: Scalar = 1.0,
    ):
        """Priors of N poses.

        Args:
            poses: (N,) indices of the poses.
            T_world_pose: (N,) their expected motions, `jaxlie.SE3` or matrices (N, 4, 4).
            information: (N, 6, 6) or (6, 6), positive semidefinite, translation first.
            valid: (N,) rows that count, all if not given.
            kernel: robust kernel.
            kernel_width: its width in standard deviations.

        Raises:
            InputError: an array without one row for each factor.
        """
        indices = as_indices("PosePrior", "poses", poses)
        check_shape("PosePrior", "poses", indices, (indices.size,))
        self._set_motions(indices[:, None], T_world_pose, information, valid, kernel, kernel_width)

    @property
    def T_world_pose(self) -> jaxlie.SE3:
        """(N,) measured poses Z."""
        return self.measured

    def residual(
        self, row: PyTree, poses: jaxlie.SE3, landmark: Float[Array, "3"] | None
    ) -> Float[Array, "6"]:
        """log(Z^-1 T)."""
        return se3.log(se3.compose(se3.inverse(row[0]), jaxlie.SE3(poses.wxyz_xyz[0])))

    def linearise(self, values: Values) -> Linearised:
        """Closed form: the inverse right Jacobian of the residual."""
        rows = self.clean_measurements()
        T, _ = self.gather(values)
        error = se3.compose(se3.inverse(rows[0]), jaxlie.SE3(T.wxyz_xyz[:, 0]))
        residual = se3.log(error).T
        return Linearised(residual, inverse_right_jacobian(residual), None, jnp.moveaxis(rows[1], 0, -1))


class RelativePose(_MeasuredMotion):
    """Measured motions between two poses: residual log(Z^-1 T_a^-1 T_b), 6 rows, translation first.

    GICP odometry and loop closures are of this kind: Z is `T_a_b`, with the information that the registration
    of source b onto target a returns.

    Attributes:
        measured: (N,) motions Z.
        matrices: (N, 6, 6) information of the residual's tangent.
    """

    relative: ClassVar[bool] = True

    def __init__(
        self,
        poses: IndexPairs,
        T_a_b: se3.Pose,
        information: Float[Array, "*n 6 6"],
        *,
        valid: Mask | None = None,
        kernel: Kernel = "none",
        kernel_width: Scalar = 1.0,
    ):
        """Motions between N pairs of poses.

        Args:
            poses: (N, 2) pairs (a, b).
            T_a_b: (N,) measured motions from coordinates of b to coordinates of a, `jaxlie.SE3` or matrices
                (N, 4, 4).
            information: (N, 6, 6) or (6, 6), positive semidefinite, translation first, of right noise.
            valid: (N,) rows that count, all if not given.
            kernel: robust kernel.
            kernel_width: its width in standard deviations.

        Raises:
            InputError: an array without one row for each factor.
        """
        indices = as_indices("RelativePose", "poses", poses)
        check_shape("RelativePose", "poses", indices, (len(indices), 2))
        self._set_motions(indices, T_a_b, information, valid, kernel, kernel_width)

    @property
    def T_a_b(self) -> jaxlie.SE3:
        """(N,) measured motions Z."""
        return self.measured

    def residual(
        self, row: PyTree, poses: jaxlie.SE3, landmark: Float[Array, "3"] | None
    ) -> Float[Array, "6"]:
        """log(Z^-1 T_a^-1 T_b)."""
        T_a, T_b = (jaxlie.SE3(poses.wxyz_xyz[i]) for i in range(2))
        return se3.log(se3.compose(se3.inverse(row[0]), se3.compose(se3.inverse(T_a), T_b)))

    def linearise(self, values: Values) -> Linearised:
        """Closed form: the inverse right Jacobian J, and -J Ad(T_b^-1 T_a) for the first pose."""
        rows = self.clean_measurements()
        T, _ = self.gather(values)
        T_a, T_b = (jaxlie.SE3(T.wxyz_xyz[:, i]) for i in range(2))
        between = se3.compose(se3.inverse(T_a), T_b)
        residual = se3.log(se3.compose(se3.inverse(rows[0]), between)).T
        at_b = inverse_right_jacobian(residual)
        back = jnp.moveaxis(se3.adjoint(se3.inverse(between)), 0, -1)
        at_a = -multiply(at_b, back)
        jacobian = jnp.concatenate([at_a, at_b], axis=1)
        return Linearised(residual, jacobian, None, jnp.moveaxis(rows[1], 0, -1))
