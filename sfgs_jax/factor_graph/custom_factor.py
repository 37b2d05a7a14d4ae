"""A user's own factor: a plain residual function and the variables it touches."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Float

from sfgs_jax.factor_graph.factor import Factor, Linearised
from sfgs_jax.factor_graph.values import Values
from sfgs_jax.geometry import Kernel


class CustomFactor(Factor):
    """Factors of any residual.

    Attributes:
        function: `function(row, poses, landmark)`, whitened residual (R,) of one row; static, so pass the
            same function object each time, not a new lambda.
        jacobian: `jacobian(row, poses, landmark)`, (R, 6 k) or (R, 6 k + 3) on the tangent, or None to
            differentiate; static.
        rows: tree of arrays with N rows: measurements, weights, parameters.
    """

    function: Callable[..., Array] = eqx.field(static=True)
    jacobian: Callable[..., Array] | None = eqx.field(static=True)
    rows: Any

    def __init__(
        self,
        function: Callable[..., Array],
        poses: Any,
        rows: Any,
        *,
        landmarks: Any = None,
        jacobian: Callable[..., Array] | None = None,
        valid: Any = None,
        kernel: Kernel = "none",
        kernel_width: Any = 1.0,
    ):
        """N factors.

        Args:
            function: residual of one row, given its measurements, its poses (a `jaxlie.SE3` of k motions)
                and its landmark (3,) or None.
            poses: (N, k) the poses each row touches; (N, 0) for none.
            rows: tree of arrays with N rows.
            landmarks: (N,) the landmark each row touches, or None.
            jacobian: its Jacobian, where it is known in closed form.
            valid: (N,) which rows count, all if not given.
            kernel: robust kernel.
            kernel_width: its width in standard deviations.
        """
        indices = np.asarray(poses, np.int32)
        self._set_rows(
            indices.reshape(-1, 1) if indices.ndim == 1 else indices, landmarks, valid, kernel, kernel_width
        )
        self.function = function
        self.jacobian = jacobian
        self.rows = jax.tree.map(jnp.asarray, rows)

    def measurements(self) -> Any:
        """The rows."""
        return self.rows

    def residual(self, row: Any, poses: jaxlie.SE3, landmark: Float[Array, "3"] | None) -> Float[Array, " R"]:
        """The user's function."""
        return self.function(row, poses, landmark)

    def linearise(self, values: Values) -> Linearised:
        """The user's Jacobian, else differentiation."""
        if self.jacobian is None:
            return super().linearise(values)
        rows, (poses, landmarks) = self.clean_measurements(), self.gather(values)
        residual = jax.vmap(self.function, out_axes=-1)(rows, poses, landmarks)
        jacobian = jax.vmap(self.jacobian, out_axes=-1)(rows, poses, landmarks)
        size = 6 * self.poses.shape[1]
        return Linearised(
            residual, jacobian[:, :size], None if landmarks is None else jacobian[:, size:], None
        )
