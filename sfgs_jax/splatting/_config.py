"""Settings of the renderer."""

from dataclasses import dataclass

from sfgs_jax.arrays import InputError, check_counts, check_positive


@dataclass(frozen=True)
class RenderConfig:
    """Settings of the renderer; hashable, so static under jit.

    Raises:
        InputError: a size or a capacity is not positive, or the depth limits are not 0 < near < far.
    """

    tile_size: int = 8
    """Side of the square tiles that the image is cut into, pixels. Small Gaussians want small tiles."""

    pair_capacity: int = 262_144
    """Room for (tile, Gaussian) pairs. Pairs beyond it are not drawn, and the rendering's `overflow` counts
    them. The function `pair_capacity` tells how many a view needs."""

    near: float = 0.1
    """Least depth along z, metres. Gaussians with a nearer centre are not drawn."""

    far: float = 1000.0
    """Greatest depth along z, metres. Gaussians with a farther centre are not drawn."""

    antialiased: bool = False
    """Compensate the low-pass filter, which widens small images, by a lower opacity (Mip-Splatting). A map
    then looks alike from near and far."""

    surface_depth: bool = False
    """Draw depth where each pixel's ray meets the surfaces too; the other depths are those of the centres. It
    takes three more channels."""

    def __post_init__(self) -> None:
        check_counts(self, 1, "tile_size", "pair_capacity")
        check_positive(self, "near", "far")
        if not self.near < self.far:
            raise InputError(f"{self}: near must be below far.")


DEFAULT = RenderConfig()
"""Default settings of all functions here."""
