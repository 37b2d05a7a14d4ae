"""Point-to-distribution residuals of pairs of frames, minimised together with everything else."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.factor_graph.factor import Factor, Linearised, Terms, squared
from sfgs_jax.factor_graph.lanes import apply, apply_transposed, multiply, multiply_transposed
from sfgs_jax.factor_graph.tangents import skew
from sfgs_jax.factor_graph.values import Values
from sfgs_jax.geometry import InputError, Kernel, se3


class DirectGicp(Factor):
    """Correspondences of registered frames: residual T_a^-1 T_b p - q, 3 rows, in coordinates of frame a.

    Each row is one source point p of frame b with its counterpart q in frame a, weighed by a 3 x 3 matrix:
    the inverse of the sum of both covariances for GICP (Segal et al., Generalized-ICP, RSS 2009, eq. 2),
    w n n^T for point to plane. Correspondences are fixed; search them anew between solves.

    The rows of a pair depend on its two poses only through the motion between them, so they are summed into
    one 6 x 6 block per pair before anything is spread over the graph.

    Attributes:
        pairs: (M, 2) poses (a, b) of each pair.
        pair: (N,) pair that a row belongs to.
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
        pairs: Any,
        source: Any,
        target: Any,
        *,
        pair: Any = None,
        information: Any = None,
        normals: Any = None,
        weights: Any = None,
        valid: Any = None,
        kernel: Kernel = "none",
        kernel_width: Any = 1.0,
    ):
        """N correspondences of M pairs of frames.

        Args:
            pairs: (M, 2) poses (a, b); a single pair may be given as (2,).
            source: (N, 3) points of frame b.
            target: (N, 3) their counterparts in frame a.
            pair: (N,) which pair each belongs to; 0 if not given.
            information: (N, 3, 3) weights in frame a; or give `normals`.
            normals: (N, 3) normals in frame a: the weight is then `weights` n n^T.
            weights: (N,) inverse variances along the normals, 1 / m²; 1 if not given.
            valid: (N,) which rows count, all if not given.
            kernel: robust kernel.
            kernel_width: its width in standard deviations.

        Raises:
            InputError: neither or both of `information` and `normals` are given.
        """
        if (information is None) == (normals is None):
            raise InputError("DirectGicp needs either information matrices or normals, not both.")
        self.source, self.target = jnp.asarray(source), jnp.asarray(target)
        count = len(self.source)
        self.pairs = np.asarray(pairs, np.int32).reshape(-1, 2)
        self.pair = np.zeros(count, np.int32) if pair is None else np.asarray(pair, np.int32)
        if information is None:
            n = jnp.asarray(normals)
            scale = jnp.ones(count, n.dtype) if weights is None else jnp.asarray(weights)
            information = scale[:, None, None] * n[:, :, None] * n[:, None]
        self.matrices = jnp.asarray(information)
        usable = np.clip(self.pair, 0, max(len(self.pairs) - 1, 0))
        poses = self.pairs[usable] if len(self.pairs) else np.zeros((count, 2), np.int32)
        self._set_rows(poses, None, valid, kernel, kernel_width)

    @property
    def groups(self) -> Int[np.ndarray, "M 2"]:
        """The pairs."""
        return np.asarray(self.pairs)

    @property
    def group_valid(self) -> Bool[np.ndarray, " M"]:
        """Pairs with a row that counts."""
        rows = np.bincount(np.asarray(self.pair)[np.asarray(self.valid)], minlength=len(self.pairs))
        return rows[: len(self.pairs)] > 0

    def measurements(self) -> Any:
        """Points and weights."""
        return self.source, self.target, self.matrices

    def information(self, rows: Any) -> Float[Array, "N 3 3"]:
        """As given."""
        return rows[2]

    def residual(self, row: Any, poses: jaxlie.SE3, landmark: Float[Array, "3"] | None) -> Float[Array, "3"]:
        """T_a^-1 T_b p - q."""
        T_a, T_b = (jaxlie.SE3(poses.wxyz_xyz[i]) for i in range(2))
        return se3.transform(se3.compose(se3.inverse(T_a), T_b), row[0]) - row[1]

    def residuals(self, values: Values) -> tuple[Float[Array, "3 N"], Float[Array, "3 3 N"]]:
        """Closed form."""
        _, moved, target, information = self._moved(values)
        return moved - target, information

    def terms(self, values: Values) -> Terms:
        """Sums per pair, spread over both poses by the motion between them."""
        between, moved, target, information = self._moved(values)
        r = moved - target
        square = squared(r, information)
        weight = self.robust_weight(square)
        # How a point of frame a moves with that frame: the pair's step there is step_b by Ad, less step_a.
        jacobian = jnp.concatenate(
            [jnp.broadcast_to(jnp.eye(3, dtype=r.dtype)[:, :, None], (3, 3, r.shape[1])), -skew(moved)],
            axis=1,
        )
        weighted = multiply(information, jacobian) * weight
        hessian = multiply_transposed(jacobian, weighted)
        gradient = apply_transposed(weighted, r)
        flat = jnp.concatenate([hessian.reshape(36, -1), gradient]).T
        count = self.pairs.shape[0]
        lane = jnp.where(jnp.asarray(self.valid), jnp.asarray(self.pair), count)
        sums = jax.ops.segment_sum(flat, lane, count + 1)[:count]
        H, g = sums[:, :36].reshape(-1, 6, 6), sums[:, 36:]
        spread = jnp.concatenate(
            [jnp.broadcast_to(-jnp.eye(6, dtype=H.dtype), H.shape), se3.adjoint(between)], axis=2
        )
        losses = jnp.where(jnp.asarray(self.valid), self.robust(square), 0)
        return Terms(
            losses,
            jnp.einsum("mia,mij,mjb->mab", spread, H, spread),
            jnp.einsum("mia,mi->ma", spread, g),
        )

    def linearise(self, values: Values) -> Linearised:
        """Row by row, for those who want the Jacobian itself."""
        between, moved, target, information = self._moved(values)
        r = moved - target
        one = jnp.broadcast_to(jnp.eye(3, dtype=r.dtype)[:, :, None], (3, 3, r.shape[1]))
        at_a = jnp.concatenate([one, -skew(moved)], axis=1)
        adjoint = jnp.moveaxis(se3.adjoint(between)[jnp.asarray(self.pair)], 0, -1)
        at_b = multiply(at_a, adjoint)
        return Linearised(r, jnp.concatenate([-at_a, at_b], axis=1), None, information)

    def _moved(
        self, values: Values
    ) -> tuple[jaxlie.SE3, Float[Array, "3 N"], Float[Array, "3 N"], Float[Array, "3 3 N"]]:
        """Motions (M,) between the pairs, source points in frame a, targets, weights."""
        source, target, information = self.clean_measurements()
        T = values.poses.wxyz_xyz
        T_a, T_b = (jaxlie.SE3(T[jnp.asarray(self.pairs)[:, i]]) for i in range(2))
        between = se3.compose(se3.inverse(T_a), T_b)
        pair = jnp.where(jnp.asarray(self.valid), jnp.asarray(self.pair), 0)
        matrices = jnp.transpose(se3.matrix(between)[:, :3], (1, 2, 0))[:, :, pair]
        moved = apply(matrices[:, :3], source.T) + matrices[:, 3]
        return between, moved, target.T, jnp.moveaxis(information, 0, -1)
