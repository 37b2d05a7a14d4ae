"""A user's own factor: a plain residual function, its poses, and at most one landmark."""

from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, ArrayLike, Float, Int, PyTree

from sfgs_jax.arrays import InputError
from sfgs_jax.factor_graph._values import Values
from sfgs_jax.factor_graph.factors._arguments import Indices, Mask, Scalar, as_indices
from sfgs_jax.factor_graph.factors._factor import Factor, Linearised
from sfgs_jax.geometry import Kernel

RowFunction = Callable[..., Array]
"""`function(row, poses, landmark)`: one row of the measurements, k poses as `jaxlie.SE3`, (3,) or None."""


class CustomFactor(Factor):
    """Factors of any residual.

    Attributes:
        function: `function(row, poses, landmark)`, whitened residual (R,) of one row. It is static, so pass
            the same function object each time, not a new lambda.
        jacobian: `jacobian(row, poses, landmark)`, (R, 6 k) or (R, 6 k + 3) by the tangents, or None to
            differentiate; static.
        rows: tree of arrays with N rows: measurements, weights, parameters.
    """

    function: RowFunction = eqx.field(static=True)
    jacobian: RowFunction | None = eqx.field(static=True)
    rows: PyTree

    def __init__(
        self,
        function: RowFunction,
        poses: Indices | Int[ArrayLike, "N k"] | Sequence[Sequence[int]],
        rows: PyTree,
        *,
        landmarks: Indices | None = None,
        jacobian: RowFunction | None = None,
        valid: Mask | None = None,
        kernel: Kernel = "none",
        kernel_width: Scalar = 1.0,
    ):
        """N factors.

        Args:
            function: residual of one row, given its measurements, its poses (a `jaxlie.SE3` of k motions)
                and its landmark (3,) or None.
            poses: (N, k) or (N,) poses of each row; (N, 0) for none.
            rows: tree of arrays with N rows.
            landmarks: (N,) landmark of each row, or None.
            jacobian: its Jacobian in closed form, if there is one.
            valid: (N,) rows that count, all if not given.
            kernel: robust kernel.
            kernel_width: its width in standard deviations.

        Raises:
            InputError: an array without one row for each factor.
        """
        indices = as_indices("CustomFactor", "poses", poses)
        indices = indices.reshape(-1, 1) if indices.ndim == 1 else indices
        self._set_rows(indices, landmarks, valid, kernel, kernel_width)
        self.function = function
        self.jacobian = jacobian
        self.rows = jax.tree.map(jnp.asarray, rows)
        for leaf in jax.tree.leaves(self.rows):
            if leaf.shape[:1] != (len(indices),):
                raise InputError(
                    f"CustomFactor needs {len(indices)} rows in every array, but one has shape {leaf.shape}."
                )

    def measurements(self) -> PyTree:
        """The rows."""
        return self.rows

    def residual(
        self, row: PyTree, poses: jaxlie.SE3, landmark: Float[Array, "3"] | None
    ) -> Float[Array, " R"]:
        """The user's function."""
        return self.function(row, poses, landmark)

    def linearise(self, values: Values) -> Linearised:
        """Residuals with the user's Jacobian, else by differentiation."""
        if self.jacobian is None:
            return super().linearise(values)
        rows, (poses, landmarks) = self.clean_measurements(), self.gather(values)
        residual = jax.vmap(self.function, out_axes=-1)(rows, poses, landmarks)
        jacobian = jax.vmap(self.jacobian, out_axes=-1)(rows, poses, landmarks)
        size = 6 * self.poses.shape[1]
        return Linearised(
            residual, jacobian[:, :size], None if landmarks is None else jacobian[:, size:], None
        )
