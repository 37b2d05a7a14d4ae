"""Solid textures: colour as a smooth function of position, so that every surface has detail without images.

A texture is a sum of plane waves in four octaves. A soft threshold turns it into blobs between two colours.
An optional grid of cells (tiles, boards, book spines) gives each cell its own tint. Plane waves are
band-limited, so detail below the pixel scale can be faded out exactly instead of turning into noise.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt32

WAVELENGTHS = (0.9, 0.36, 0.15, 0.065)
"""Wavelengths of the four octaves, metres."""
_WAVES_PER_OCTAVE = 6


class Materials(eqx.Module):
    """Parameters of M textures.

    Attributes:
        colours: the two colours between which the waves go, RGB in [0, 1].
        octaves: weight of each octave.
        contrast: steepness of the threshold between the two colours.
        cells: cells per metre along each world axis; 0 for none.
        gap: half the width of the line between cells, metres.
        tint: share of a cell's own tint in its colour, 0 to 1.
    """

    colours: Float[Array, "m 2 3"]
    octaves: Float[Array, "m 4"]
    contrast: Float[Array, " m"]
    cells: Float[Array, "m 3"]
    gap: Float[Array, " m"]
    tint: Float[Array, " m"]


class Waves(eqx.Module):
    """Plane waves in random directions, shared by all textures.

    Attributes:
        vectors: wave vectors of each octave, in periods a metre.
        phases: phase of each wave, in periods.
    """

    vectors: Float[Array, "4 w 3"]
    phases: Float[Array, "4 w"]


def random_waves(rng: np.random.Generator) -> Waves:
    """Waves whose lengths spread around the octaves' wavelengths."""
    shape = (len(WAVELENGTHS), _WAVES_PER_OCTAVE)
    directions = rng.normal(size=(*shape, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    lengths = np.asarray(WAVELENGTHS)[:, None] * rng.uniform(0.75, 1.3, shape)
    return Waves(
        jnp.asarray(directions / lengths[..., None], jnp.float32),
        jnp.asarray(rng.uniform(0, 1, shape), jnp.float32),
    )


def surface_colours(
    materials: Materials,
    waves: Waves,
    material: Int[Array, " n"],
    points: Float[Array, "n 3"],
    footprint: Float[Array, " n"],
) -> Float[Array, "n 3"]:
    """Colour of surface points before lighting.

    Args:
        materials: the textures.
        waves: the plane waves of the textures.
        material: index of each point's texture.
        points: world coordinates, metres.
        footprint: width of a pixel on the surface, metres; finer detail fades out.
    """
    noise = _octaves(waves, points, footprint)
    height = jnp.sum(noise * materials.octaves[material], axis=1)
    blend = 0.5 + 0.5 * jnp.tanh(materials.contrast[material] * height)
    colours = materials.colours[material]
    colour = colours[:, 0] + blend[:, None] * (colours[:, 1] - colours[:, 0])
    return _with_cells(materials, material, points, footprint, colour)


def _octaves(waves: Waves, points: Float[Array, "n 3"], footprint: Float[Array, " n"]) -> Float[Array, "n 4"]:
    """Sum of the waves of each octave, of unit variance where a pixel is much smaller than the wave."""
    x, y, z = points.T
    octaves = []
    for wavelength, vectors, phases in zip(WAVELENGTHS, waves.vectors, waves.phases, strict=True):
        total = jnp.zeros_like(x)
        # Unrolled, so that it becomes one loop over x.
        for (a, b, c), phase in zip(vectors, phases, strict=True):
            total = total + cosine_of_periods(a * x + b * y + c * z + phase)
        # Transfer function of a Gaussian filter whose standard deviation is half a pixel.
        fade = jnp.exp(-0.5 * (np.pi / wavelength * footprint) ** 2)
        octaves.append(fade * total * (2 / _WAVES_PER_OCTAVE) ** 0.5)
    return jnp.stack(octaves, axis=1)


def cosine_of_periods(periods: Float[Array, " n"]) -> Float[Array, " n"]:
    """cos(2 pi periods) to 2e-4, by its Taylor series around the zero; far faster than XLA's on a CPU."""
    x = 0.25 - jnp.abs(periods - jnp.round(periods))
    square = x * x
    return x * (6.2831853 - square * (41.3417 - square * (81.6052 - square * 76.7059)))


def _with_cells(
    materials: Materials,
    material: Int[Array, " n"],
    points: Float[Array, "n 3"],
    footprint: Float[Array, " n"],
    colour: Float[Array, "n 3"],
) -> Float[Array, "n 3"]:
    """The colour with each cell's tint, and with dark lines between cells that hide where tints change."""
    density = materials.cells[material]
    has_cells = density > 0
    position = points * density
    cell = jnp.floor(position)
    inside = position - cell
    to_border = jnp.minimum(inside, 1 - inside) / jnp.where(has_cells, density, 1)
    distance = jnp.min(jnp.where(has_cells, to_border, jnp.inf), axis=1)
    tint = _cell_tints(jnp.where(has_cells, cell, 0).astype(jnp.int32))
    amount = materials.tint[material][:, None]
    tinted = colour * (1 - amount) + amount * tint * (0.6 + 0.4 * colour)
    half_width = materials.gap[material]
    softness = jnp.maximum(footprint, 0.25 * half_width)
    t = jnp.clip((distance - half_width + softness) / (2 * softness), 0, 1)
    t = t * t * (3 - 2 * t)
    line = jnp.any(has_cells, axis=1)[:, None] & (half_width > 0)[:, None]
    return jnp.where(line, tinted * (0.35 + 0.65 * t[:, None]), tinted)


def _cell_tints(cell: Int[Array, "n 3"]) -> Float[Array, "n 3"]:
    """A colour for each cell, from a hash of its integer coordinates."""
    bits = jax.lax.bitcast_convert_type(cell, jnp.uint32)
    mixed = (
        bits[:, 0] * np.uint32(73856093) ^ bits[:, 1] * np.uint32(19349663) ^ bits[:, 2] * np.uint32(83492791)
    )
    channels = [_mix(mixed + np.uint32(salt)) for salt in (1, 2, 3)]
    return 0.15 + 0.75 * jnp.stack([(c >> 8).astype(jnp.float32) / 2**24 for c in channels], axis=1)


def _mix(x: UInt32[Array, " n"]) -> UInt32[Array, " n"]:
    """Scramble bits: the finaliser of MurmurHash3."""
    x = (x ^ (x >> 16)) * np.uint32(0x85EBCA6B)
    x = (x ^ (x >> 13)) * np.uint32(0xC2B2AE35)
    return x ^ (x >> 16)
