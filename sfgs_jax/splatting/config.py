"""Settings of the renderer."""

from dataclasses import dataclass

from sfgs_jax.geometry import InputError


@dataclass(frozen=True)
class RenderConfig:
    """Settings of the renderer; hashable, so static under jit."""

    tile_size: int = 8
    """Side of the square tiles, pixels. Small Gaussians want small tiles."""

    pair_capacity: int = 262_144
    """(tile, Gaussian) pairs there is room for; the `pair_capacity` function says what a view needs."""

    near: float = 0.1
    """Gaussians whose centre is nearer than this along z are not drawn, metres."""

    far: float = 1000.0
    """Gaussians whose centre is farther than this along z are not drawn, metres."""

    antialiased: bool = False
    """Weaken the opacity of Gaussians by as much as the low-pass filter spreads them (Mip-Splatting)."""

    def __post_init__(self) -> None:
        if self.tile_size < 1 or self.pair_capacity < 1 or not 0 < self.near < self.far:
            raise InputError(f"{self}: tile_size and pair_capacity must be positive, and 0 < near < far.")


DEFAULT = RenderConfig()
"""The settings that functions take where none are given."""
