"""Places of matched keypoints, refined by the images around them.

A detector finds a corner to half a pixel, and beside an outline it finds one that moves with the outline. The
patches around two keypoints tell their places to a tenth of a pixel, and whether both show the same at all.

Source: Baker and Matthews, Lucas-Kanade 20 years on (IJCV 2004), section 3.2, the inverse compositional way.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from sfgs_jax.geometry import Camera

_WIDTH = 320
"""Width of images that patches are taken from, pixels. Larger ones hold little more detail."""
_HALF = 3
"""Pixels from a patch's middle to its side: patches of 7 x 7."""
_REACH = 3.0
"""Largest shift along each axis, pixels of such an image; what has to move farther shows something else."""
_NOISE = 0.02
"""Standard deviation of the difference of two patches at a pixel, of 1."""
_FIRM = 0.5
"""Shift, pixels, up to which the pull back to where a place was detected grows (pseudo-Huber kernel)."""
_RELAXATION = 0.8
"""Share of a Gauss-Newton step. Whole steps overshoot if the source is sharper than the target."""
_AT_REST = 0.1
"""Length of the last step, pixels, above which no place was found."""
_SLOWEST = 0.9
"""Length of the last step as a share of the one before, above which its place is told by next to nothing."""
_LEAST_GAIN = 0.3
"""Least contrast of a patch as a share of the other's."""


class PatchPairs(NamedTuple):
    """Patches of two images around matched keypoints, the source's upright, the target's as it sees the same.

    Attributes:
        source: (h, w) grey image, reduced by `patch_factor`.
        target: (h, w) likewise.
        places: (2, K) of the source's keypoints there.
        target_places: (2, K) of the target's.
        warps: (2, 2, K) derivative of the target's pixels by the source's.
        detected: standard deviation of a place as detected, pixels of these images.
    """

    source: Float[Array, "h w"]
    target: Float[Array, "h w"]
    places: Float[Array, "2 K"]
    target_places: Float[Array, "2 K"]
    warps: Float[Array, "2 2 K"]
    detected: Float[Array, ""]


def patch_factor(width: int) -> int:
    """Whole factor by which an image is reduced for its patches.

    Args:
        width: of the image, pixels.
    """
    return max(1, width // _WIDTH)


def reduced(pixels: Float[Array, "K 2"], camera: Camera) -> Float[Array, "2 K"]:
    """Places in the reduced image.

    Args:
        pixels: (u, v).
        camera: of the whole image.
    """
    factor = patch_factor(camera.width)
    return (pixels.T - (factor - 1) / 2) / factor


class Alignment(NamedTuple):
    """Where patches look most alike.

    Attributes:
        shift: (2, K) of the source's keypoints.
        agreement: (K,) correlation of the patches there, at most 1, without derivatives; 0 where one has no
            contrast, had to move too far, or came not to rest.
    """

    shift: Float[Array, "2 K"]
    agreement: Float[Array, " K"]


@eqx.filter_custom_jvp
def aligned(pairs: PatchPairs, *, steps: int) -> Alignment:
    """Shifts of the source's keypoints to where their patches look most like the target's.

    The most likely ones: patches have noise, a gain and an offset, and a keypoint lies near where it was
    detected. Along an edge that alone tells where.

    Args:
        pairs: patches of the matches.
        steps: of Gauss-Newton.
    """
    template = _template(pairs)
    a, b, c = template.hessian
    determinant = (a * c - b * b)[None]

    def step(_: Array, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        before, last, _ = state
        slope = _slope(pairs, template, before)
        move = jnp.stack([c * slope[0] - b * slope[1], a * slope[1] - b * slope[0]]) / determinant
        shift = jnp.clip(before + jnp.clip(_RELAXATION * move, -1, 1), -_REACH, _REACH)
        return shift, jnp.max(jnp.abs(shift - before), axis=0), last

    zero = jnp.zeros_like(pairs.places)
    shift, last, before = lax.fori_loop(0, steps, step, (zero, zero[0], zero[0]))
    converges = (last <= _SLOWEST * before) | (last < jnp.finfo(last.dtype).eps ** 0.5)
    found = converges & (last < _AT_REST) & _within_reach(shift)
    # Well out of reach, so that whoever takes these shifts up again, less exactly, leaves them out too.
    shift = jnp.where(found[None], shift, 2 * _REACH)
    return Alignment(shift, _agreement(pairs, template, shift))


@aligned.def_jvp
def _aligned_jvp(primals: tuple, tangents: tuple, *, steps: int) -> tuple[Alignment, Any]:
    """The shift moves with anything like one Newton step from it."""
    (pairs,), (rates,) = primals, tangents
    found = aligned(pairs, steps=steps)
    _, rate = eqx.filter_jvp(lambda moving: aligned_again(found.shift, moving), (pairs,), (rates,))
    return found, rate


def aligned_again(shift: Float[Array, "2 K"], pairs: PatchPairs) -> Alignment:
    """An alignment with its derivatives, by one Newton step, without the steps that led there.

    Args:
        shift: the most likely ones; one that reached the limit stays.
        pairs: patches of the matches.
    """
    shift, fixed = lax.stop_gradient((shift, pairs))

    def slope_at(at: Float[Array, "2 K"]) -> Float[Array, "2 K"]:
        return _slope(fixed, _template(fixed), at)

    along = [jnp.zeros_like(shift).at[axis].set(1) for axis in (0, 1)]
    (a, c), (b, d) = (jax.jvp(slope_at, (shift,), (unit,))[1] for unit in along)
    determinant = a * d - b * c
    slope = _slope(pairs, _template(pairs), shift)
    sound = (jnp.abs(determinant) > 1e-6) & _within_reach(shift)
    move = jnp.stack([d * slope[0] - b * slope[1], a * slope[1] - c * slope[0]])
    moved = shift - jnp.where(sound[None], move / jnp.where(sound, determinant, 1)[None], 0)
    return Alignment(moved, _agreement(fixed, _template(fixed), shift))


def _within_reach(shift: Float[Array, "2 K"]) -> Bool[Array, " K"]:
    return jnp.all(jnp.abs(shift) < _REACH, axis=0)


def _agreement(pairs: PatchPairs, template: "_Template", shift: Float[Array, "2 K"]) -> Float[Array, " K"]:
    wanted, seen = template.values, _centred(_upright(pairs.source, pairs.places + shift))
    norm = jnp.sqrt(jnp.sum(wanted * wanted, 0) * jnp.sum(seen * seen, 0))
    found = (norm > 0) & _within_reach(shift)
    return lax.stop_gradient(jnp.where(found, jnp.sum(wanted * seen, 0) / jnp.where(found, norm, 1), 0))


class _Template(NamedTuple):
    """Patches of the target, less their means, as rows of pixels.

    Attributes:
        values: (n, K).
        across: (n, K) derivatives along the source's rows.
        down: (n, K) along its columns.
        hessian: of the negative log-likelihood at the place as detected, the upper triangle's elements (K,).
        pull: 1 / variance of a place as detected.
    """

    values: Float[Array, "n K"]
    across: Float[Array, "n K"]
    down: Float[Array, "n K"]
    hessian: tuple[Float[Array, " K"], Float[Array, " K"], Float[Array, " K"]]
    pull: Float[Array, ""]


def _template(pairs: PatchPairs) -> _Template:
    span, count = jnp.arange(-_HALF - 1, _HALF + 2, dtype=pairs.source.dtype), pairs.places.shape[1]

    def row(step: Float[Array, ""]) -> Float[Array, "m K"]:
        right, below = pairs.warps[:, 0, None] * span[None, :, None], pairs.warps[:, 1, None] * step
        return _sampled(pairs.target, *(pairs.target_places[:, None] + right + below))

    # Row by row, or each reader of these pixels would look them up again.
    patch = lax.map(row, span)
    across = (patch[1:-1, 2:] - patch[1:-1, :-2]) / 2
    down = (patch[2:, 1:-1] - patch[:-2, 1:-1]) / 2
    values, across, down = (_centred(x.reshape(-1, count)) for x in (patch[1:-1, 1:-1], across, down))
    pull, weight = pairs.detected**-2, _NOISE**-2
    a, c = (weight * jnp.sum(x * x, 0) + pull for x in (across, down))
    return _Template(values, across, down, (a, weight * jnp.sum(across * down, 0), c), pull)


def _slope(pairs: PatchPairs, template: _Template, shift: Float[Array, "2 K"]) -> Float[Array, "2 K"]:
    """Derivative of the log-likelihood by the shift, with the derivatives of the target's patches."""
    values = template.values
    seen = _centred(_upright(pairs.source, pairs.places + shift))
    square = jnp.sum(values * values, 0)
    gain = jnp.sum(seen * values, 0) / jnp.where(square > 0, square, 1)
    off = values - seen / jnp.maximum(gain, _LEAST_GAIN)[None]
    by = jnp.stack([jnp.sum(template.across * off, 0), jnp.sum(template.down * off, 0)])
    # Some places are off by pixels, since they stay with an outline beside them.
    pull = template.pull / jnp.sqrt(1 + jnp.sum(shift * shift, 0) / _FIRM**2)
    return _NOISE**-2 * by - pull[None] * shift


def _centred(patch: Float[Array, "n K"]) -> Float[Array, "n K"]:
    return patch - jnp.mean(patch, 0)[None]


def _upright(image: Float[Array, "h w"], centres: Float[Array, "2 K"]) -> Float[Array, "n K"]:
    """Patches around some places, by bilinear interpolation; images go on as they end."""
    height, width = image.shape
    corner = jnp.floor(lax.stop_gradient(centres))
    right, down = centres - corner
    column, row = corner.astype(jnp.int32)
    span, flat = jnp.arange(-_HALF, _HALF + 2), image.reshape(-1)
    columns = jnp.clip(column[None] + span[:, None], 0, width - 1)
    around = lax.map(lambda step: flat[jnp.clip(row + step, 0, height - 1)[None] * width + columns], span)
    across = around[:, :-1] + (around[:, 1:] - around[:, :-1]) * right[None, None]
    return (across[:-1] + (across[1:] - across[:-1]) * down[None, None]).reshape(-1, centres.shape[1])


def _sampled(
    image: Float[Array, "h w"], u: Float[Array, "n K"], v: Float[Array, "n K"]
) -> Float[Array, "n K"]:
    """Bilinear interpolation at some places; images go on as they end."""
    height, width = image.shape
    left, top = (jnp.floor(lax.stop_gradient(x)) for x in (u, v))
    right, down = u - left, v - top
    columns = [jnp.clip(left.astype(jnp.int32) + step, 0, width - 1) for step in (0, 1)]
    rows = [jnp.clip(top.astype(jnp.int32) + step, 0, height - 1) * width for step in (0, 1)]
    flat = image.reshape(-1)
    upper, lower = (flat[row + columns[0]] * (1 - right) + flat[row + columns[1]] * right for row in rows)
    return upper * (1 - down) + lower * down
