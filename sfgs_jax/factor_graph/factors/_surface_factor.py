"""Surface factor: point-to-distribution residuals of pairs of frames, minimised with all other factors."""

from collections.abc import Sequence
from typing import ClassVar

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jax.lax import Precision
from jaxtyping import Array, ArrayLike, Bool, Float, Int, PyTree

from sfgs_jax.arrays import InputError, apply, apply_transposed, multiply, multiply_transposed
from sfgs_jax.factor_graph._values import Values
from sfgs_jax.factor_graph.factors._arguments import Indices, Mask, Scalar, as_indices, check_shape
from sfgs_jax.factor_graph.factors._factor import Factor, Linearised, Terms, squared_mahalanobis
from sfgs_jax.geometry import Kernel, se3, skew


class DirectGicp(Factor):
    """Correspondences of registered frames: residual T_a^-1 T_b p - q, 3 rows, in coordinates of frame a.

    Each row is one source point p of frame b with its counterpart q in frame a, and a 3 x 3 weight. For GICP
    this is the inverse of the sum of both covariances (Segal et al., Generalized-ICP, RSS 2009, eq. 2); for
    point to plane it is w n n^T. Correspondences are fixed; search them anew between solves.

    The rows of a pair depend on its two poses only through the motion between them. They are summed into one
    6 x 6 block per pair, which is then spread over the graph.

    Attributes:
        pairs: (M, 2) poses (a, b) of each pair.
        pair: (N,) pair of each row.
        source: (N, 3) points in frame b, metres.
        target: (N, 3) points in frame a, metres.
        matrices: (N, 3, 3) weights in frame a, 1 / m².
    """

    relative: ClassVar[bool] = True
    pairs: Int[Array | np.ndarray, "M 2"]
    pair: Int[Array | np.ndarray, " N"]
    source: Float[Array, "N 3"]
    target: Float[Array, "N 3"]
    matrices: Float[Array, "N 3 3"]

    def __init__(
        self,
        pairs: Int[ArrayLike, "M 2"] | Int[ArrayLike, "2"] | Sequence[Sequence[int]] | Sequence[int],
        source: Float[ArrayLike, "N 3"],
        target: Float[ArrayLike, "N 3"],
        *,
        pair: Indices | None = None,
        information: Float[ArrayLike, "N 3 3"] | None = None,
        normals: Float[ArrayLike, "N 3"] | None = None,
        weights: Float[ArrayLike, " N"] | None = None,
        valid: Mask | None = None,
        kernel: Kernel = "none",
        kernel_width: Scalar = 1.0,
    ):
        """N correspondences of M pairs of frames.

        Args:
            pairs: (M, 2) poses (a, b); a single pair may be given as (2,).
            source: (N, 3) points of frame b.
            target: (N, 3) their counterparts in frame a.
            pair: (N,) pair of each; 0 if not given.
            information: (N, 3, 3) weights in frame a; or give `normals`.
            normals: (N, 3) normals in frame a: the weight is then `weights` n n^T.
            weights: (N,) inverse variances along the normals, 1 / m²; 1 if not given.
            valid: (N,) rows that count, all if not given.
            kernel: robust kernel.
            kernel_width: its width in standard deviations.

        Raises:
            InputError: neither or both of `information` and `normals` are given, an array without one row
                for each factor, or a pair out of range.
        """
        if (information is None) == (normals is None):
            raise InputError("DirectGicp needs either information matrices or normals, not both.")
        indices = as_indices("DirectGicp", "pairs", pairs)
        indices = indices[None] if indices.shape == (2,) else indices
        check_shape("DirectGicp", "pairs", indices, (len(indices), 2))
        self.pairs = indices
        self.source, self.target = jnp.asarray(source), jnp.asarray(target)
        count = self.source.shape[0]
        self.pair = np.zeros(count, np.int32) if pair is None else as_indices("DirectGicp", "pair", pair)
        check_shape("DirectGicp", "pair", self.pair, (count,))
        usable = np.clip(self.pair, 0, max(len(indices) - 1, 0))
        poses = indices[usable] if len(indices) else np.zeros((count, 2), np.int32)
        self._set_rows(poses, None, valid, kernel, kernel_width)
        if np.any((usable != self.pair) & self.valid) or (not len(indices) and np.any(self.valid)):
            raise InputError(f"DirectGicp has rows of pairs beyond its {len(indices)} pairs.")
        self._check_rows("source", self.source, (3,))
        self._check_rows("target", self.target, (3,))
        if normals is not None:
            self._check_rows("normals", normals, (3,))
            n = jnp.asarray(normals)
            scale = jnp.ones(count, n.dtype) if weights is None else jnp.asarray(weights)
            self._check_rows("weights", scale, ())
            information = scale[:, None, None] * n[:, :, None] * n[:, None]
        assert information is not None
        self._check_rows("information", information, (3, 3))
        self.matrices = jnp.asarray(information)

    @property
    def groups(self) -> Int[np.ndarray, "M 2"]:
        """The pairs."""
        return np.asarray(self.pairs)

    @property
    def group_valid(self) -> Bool[np.ndarray, " M"]:
        """Pairs with a row that counts."""
        rows = np.bincount(np.asarray(self.pair)[np.asarray(self.valid)], minlength=len(self.pairs))
        return rows[: len(self.pairs)] > 0

    def measurements(self) -> PyTree:
        """Points and weights."""
        return self.source, self.target, self.matrices

    def information(self, rows: PyTree) -> Float[Array, "N 3 3"]:
        """Weights as given."""
        return rows[2]

    def residual(
        self, row: PyTree, poses: jaxlie.SE3, landmark: Float[Array, "3"] | None
    ) -> Float[Array, "3"]:
        """T_a^-1 T_b p - q."""
        T_a, T_b = (jaxlie.SE3(poses.wxyz_xyz[i]) for i in range(2))
        return se3.transform(se3.compose(se3.inverse(T_a), T_b), row[0]) - row[1]

    def residuals(self, values: Values) -> tuple[Float[Array, "3 N"], Float[Array, "3 3 N"]]:
        """Closed form."""
        _, moved, target, information = self._moved(values)
        return moved - target, information

    def terms(self, values: Values) -> Terms:
        """Normal equations: sums per pair, spread over both poses by the motion between them."""
        between, moved, target, information = self._moved(values)
        r = moved - target
        square = squared_mahalanobis(r, information)
        weight = self.robust_weight(square)
        jacobian = _by_motion(moved)
        weighted = multiply(information, jacobian) * weight[None, None]
        hessian = multiply_transposed(jacobian, weighted)
        gradient = apply_transposed(weighted, r)
        flat = jnp.concatenate([hessian.reshape(36, -1), gradient]).T
        count = self.pairs.shape[0]
        lane = jnp.where(jnp.asarray(self.valid), jnp.asarray(self.pair), count)
        sums = jax.ops.segment_sum(flat, lane, count + 1)[:count]
        H, g = sums[:, :36].reshape(-1, 6, 6), sums[:, 36:]
        # The step of the pair's motion, in frame a, is Ad step_b - step_a.
        minus = jnp.broadcast_to(-jnp.eye(6, dtype=H.dtype), H.shape)
        spread = jnp.concatenate([minus, se3.adjoint(between)], axis=2)
        return Terms(
            jnp.where(jnp.asarray(self.valid), self.robust(square), 0),
            jnp.einsum("mia,mij,mjb->mab", spread, H, spread, precision=Precision.HIGHEST),
            jnp.einsum("mia,mi->ma", spread, g, precision=Precision.HIGHEST),
        )

    def linearise(self, values: Values) -> Linearised:
        """Residuals with Jacobians in closed form; `terms` does without them."""
        between, moved, target, information = self._moved(values)
        at_a = _by_motion(moved)
        adjoint = jnp.moveaxis(se3.adjoint(between)[jnp.asarray(self.pair)], 0, -1)
        jacobian = jnp.concatenate([-at_a, multiply(at_a, adjoint)], axis=1)
        return Linearised(moved - target, jacobian, None, information)

    def _moved(
        self, values: Values
    ) -> tuple[jaxlie.SE3, Float[Array, "3 N"], Float[Array, "3 N"], Float[Array, "3 3 N"]]:
        """Motions (M,) of the pairs, source points in frame a, target points, weights."""
        source, target, information = self.clean_measurements()
        T = values.poses.wxyz_xyz
        T_a, T_b = (jaxlie.SE3(T[jnp.asarray(self.pairs)[:, i]]) for i in range(2))
        between = se3.compose(se3.inverse(T_a), T_b)
        pair = jnp.where(jnp.asarray(self.valid), jnp.asarray(self.pair), 0)
        matrices = jnp.transpose(se3.matrix(between)[:, :3], (1, 2, 0))[:, :, pair]
        moved = apply(matrices[:, :3], source.T) + matrices[:, 3]
        return between, moved, target.T, jnp.moveaxis(information, 0, -1)


def _by_motion(points: Float[Array, "3 N"]) -> Float[Array, "3 6 N"]:
    """Derivative of points of frame a that move with a step of that frame: (1, -[p])."""
    one = jnp.broadcast_to(jnp.eye(3, dtype=points.dtype)[:, :, None], (3, 3, points.shape[1]))
    return jnp.concatenate([one, -skew(points)], axis=1)
