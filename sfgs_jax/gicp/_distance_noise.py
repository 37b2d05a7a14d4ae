"""Noise of the distances between a depth image and a surface."""

import equinox as eqx
from jaxtyping import Array, Float


class DistanceNoise(eqx.Module):
    """Standard deviation of a depth pixel's distance from the surface, by its depth z: a + b z².

    Attributes:
        metres: a, at any depth.
        per_square_metre: b, 1/m; see `GicpConfig.noise_per_square_metre`.
    """

    metres: Float[Array, ""] | float
    per_square_metre: Float[Array, ""] | float

    def deviation(self, depth: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Standard deviation at some depths, metres."""
        return self.metres + self.per_square_metre * depth**2
