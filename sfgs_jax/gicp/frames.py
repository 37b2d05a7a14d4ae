"""Motions between clouds that are kept relative to an origin of their own."""

import equinox as eqx
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Float

from sfgs_jax.geometry import se3
from sfgs_jax.gicp.prior import MotionPrior


class Frames(eqx.Module):
    """Origins of a source and a target, and what goes from the coordinates given to the centred ones.

    Attributes:
        source: (3,) origin of the source, metres.
        target: (3,) origin of the target, metres.
    """

    source: Float[Array, "3"]
    target: Float[Array, "3"]

    def centred(self, T_target_source: jaxlie.SE3) -> jaxlie.SE3:
        """The motion between the centred clouds."""
        shift = se3.transform(T_target_source, self.source) - self.target
        return _moved_to(T_target_source, shift)

    def given(self, T_centred: jaxlie.SE3) -> jaxlie.SE3:
        """The motion between the clouds as they were given."""
        shift = se3.transform(T_centred, -self.source) + self.target
        return _moved_to(T_centred, shift)

    def centred_prior(self, prior: MotionPrior) -> MotionPrior:
        """The prior of the motion between the centred clouds."""
        change = se3.adjoint(_translation(self.source))
        information = change.T @ prior.information @ change
        return MotionPrior(self.centred(prior.T_target_source), information)

    def given_information(self, information: Float[Array, "6 6"]) -> Float[Array, "6 6"]:
        """Information in the tangent at the motion between the clouds as given."""
        change = se3.adjoint(_translation(-self.source))
        return change.T @ information @ change

    def given_tangents(self, tangents: Float[Array, "6 K"]) -> Float[Array, "6 K"]:
        """Tangent vectors, as columns, at the motion between the clouds as given."""
        return se3.adjoint(_translation(self.source)) @ tangents


def _moved_to(T: jaxlie.SE3, translation: Float[Array, "3"]) -> jaxlie.SE3:
    return jaxlie.SE3(jnp.concatenate([T.wxyz_xyz[:4], translation]))


def _translation(by: Float[Array, "3"]) -> jaxlie.SE3:
    return _moved_to(se3.identity(by.dtype), by)
