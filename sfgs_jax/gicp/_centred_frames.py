"""Change of coordinates between clouds as given and the same clouds centred at origins of their own.

Small coordinates keep the digits of float32.
"""

import equinox as eqx
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Float

from sfgs_jax.geometry import se3
from sfgs_jax.gicp._exact_products import exact_products
from sfgs_jax.gicp._normal_equations import MotionPrior


class CentredFrames(eqx.Module):
    """Origins of a source and a target; what is centred is relative to them.

    Attributes:
        source: (3,) origin of the source, metres.
        target: (3,) origin of the target, metres.
    """

    source: Float[Array, "3"]
    target: Float[Array, "3"]

    @exact_products
    def centred(self, T_target_source: jaxlie.SE3) -> jaxlie.SE3:
        """Motion between the centred clouds."""
        shift = se3.transform(T_target_source, self.source) - self.target
        return _with_translation(T_target_source, shift)

    @exact_products
    def uncentred(self, T_centred: jaxlie.SE3) -> jaxlie.SE3:
        """Motion between the clouds as given."""
        shift = se3.transform(T_centred, -self.source) + self.target
        return _with_translation(T_centred, shift)

    @exact_products
    def centred_prior(self, prior: MotionPrior) -> MotionPrior:
        """Prior of the motion between the centred clouds."""
        change = se3.adjoint(_translation(self.source))
        information = change.T @ prior.information @ change
        return MotionPrior(self.centred(prior.T_target_source), information)

    @exact_products
    def uncentred_information(self, information: Float[Array, "6 6"]) -> Float[Array, "6 6"]:
        """Information in the tangent at the motion between the clouds as given."""
        change = se3.adjoint(_translation(-self.source))
        return change.T @ information @ change

    @exact_products
    def uncentred_tangents(self, tangents: Float[Array, "6 K"]) -> Float[Array, "6 K"]:
        """Tangent vectors, as columns, at the motion between the clouds as given."""
        return se3.adjoint(_translation(self.source)) @ tangents


def _with_translation(T: jaxlie.SE3, translation: Float[Array, "3"]) -> jaxlie.SE3:
    return jaxlie.SE3(jnp.concatenate([T.wxyz_xyz[:4], translation]))


def _translation(by: Float[Array, "3"]) -> jaxlie.SE3:
    return _with_translation(se3.identity(by.dtype), by)
