"""What is known of a motion before registration."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Float

from sfgs_jax.geometry import se3


class MotionPrior(eqx.Module):
    """Gaussian over motions: T = mean exp(x) with x of zero mean.

    Attributes:
        T_target_source: mean.
        information: (6, 6) inverse covariance of x (translation first), metres and radians.
    """

    T_target_source: jaxlie.SE3
    information: Float[Array, "6 6"]


def prior_equations(
    prior: MotionPrior, T: jaxlie.SE3
) -> tuple[Float[Array, "6 6"], Float[Array, "6"], Float[Array, ""]]:
    """Hessian, gradient and value of half x^T Lambda x, x = log(mean^-1 T exp(delta)), at delta = 0."""
    T_mean_T = se3.compose(se3.inverse(prior.T_target_source), T)

    def deviation(delta: Float[Array, "6"]) -> Float[Array, "6"]:
        return se3.log(se3.compose(T_mean_T, se3.exp(delta)))

    zero = jnp.zeros(6, T.wxyz_xyz.dtype)
    jacobian = jax.jacfwd(deviation)(zero)
    weighted = jacobian.T @ prior.information
    x = deviation(zero)
    return weighted @ jacobian, weighted @ x, x @ prior.information @ x / 2
