"""From the network's logits to keypoints.

Maps of pixels are kept by place here: [i, j, r, c] is row i and column j within the cell in row r and
column c of the image. So whole maps of cells follow each other in memory, and all of this runs along vectors.
"""

from functools import reduce

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.superfeats.network import CELL

MIN_HEAT = 0.01
"""Probability of a keypoint at its pixel below which there is none."""
_MARGIN = CELL // 2
"""Pixels that the network's first layer sees beyond each cell."""
_REACH = 2
"""Pixels to each side over which a keypoint must be the maximum: a window of 5 x 5."""


def heat_map(logits: Float[Array, "65 r c"]) -> Float[Array, "8 8 r c"]:
    """Probability of a keypoint at each pixel: softmax over a cell's places and its dustbin."""
    # Without the maximum taken off, which softmax does for safety, the exponentials fuse with the rest.
    weights = jnp.exp(jnp.clip(logits, -80.0, 80.0))
    return (weights[:-1] / weights.sum(0)).reshape(CELL, CELL, *logits.shape[1:])


def cut(heat: Float[Array, "8 8 r c"], height: int, width: int) -> Float[Array, "8 8 r c"]:
    """No heat beyond an image that doesn't fill its cells."""
    places, (rows, columns) = jnp.arange(CELL), heat.shape[2:]
    if height < CELL * rows:
        inside = CELL * jnp.arange(rows) + places[:, None] < height
        heat = jnp.where(inside[:, None, :, None], heat, 0.0)
    if width < CELL * columns:
        inside = CELL * jnp.arange(columns) + places[:, None] < width
        heat = jnp.where(inside[:, None], heat, 0.0)
    return heat


def away_from_border(heat: Float[Array, "8 8 r c"], height: int, width: int) -> Bool[Array, "8 8 r c"]:
    """Pixels whose surroundings, as far as the network's first layer sees them, lie in the image.

    At the border it sees where the image ends, which is no point of what the image shows.
    """
    places, (rows, columns) = jnp.arange(CELL), heat.shape[2:]
    v = CELL * jnp.arange(rows) + places[:, None]
    u = CELL * jnp.arange(columns) + places[:, None]
    inside_v, inside_u = ((x >= _MARGIN) & (x < side - _MARGIN) for x, side in ((v, height), (u, width)))
    return inside_v[:, None, :, None] & inside_u[:, None]


def local_maxima(heat: Float[Array, "8 8 r c"]) -> Bool[Array, "8 8 r c"]:
    """Pixels that no other within two pixels exceeds."""
    # Shifted slices fuse into loops; `reduce_window` takes five times as long on a CPU.
    return heat >= _running_maximum(_running_maximum(lax.stop_gradient(heat), 1), 0)


def strongest(
    scores: Float[Array, "8 8 r c"], *, count: int
) -> tuple[Float[Array, " k"], Float[Array, "k 2"]]:
    """The `count` highest scores, in falling order, and their pixels (u, v); scores of 0 fill up.

    Of four pixels in a square one counts: maxima of 5 x 5 windows lie further apart, but for equal ones.
    """
    # A quarter of the candidates takes `top_k` a third of the time.
    upper, lower = scores[0::2], scores[1::2]
    squares = jnp.maximum(
        jnp.maximum(upper[:, 0::2], upper[:, 1::2]), jnp.maximum(lower[:, 0::2], lower[:, 1::2])
    )
    found, index = lax.top_k(squares.reshape(-1), min(count, squares.size))
    missing = count - found.size
    found, index = jnp.pad(found, (0, missing)), jnp.pad(index, (0, missing))

    square_v, square_u, r, c = jnp.unravel_index(index, squares.shape)
    v, u = 2 * square_v + CELL * r, 2 * square_u + CELL * c
    four = _look_up(scores, v[:, None] + jnp.array([0, 0, 1, 1]), u[:, None] + jnp.array([0, 1, 0, 1]))
    place = jnp.argmax(four == found[:, None], axis=1)
    return found, jnp.stack([u + place % 2, v + place // 2], -1).astype(scores.dtype)


def refine(heat: Float[Array, "8 8 r c"], pixels: Float[Array, "k 2"]) -> Float[Array, "k 2"]:
    """Moves each pixel (u, v) to the centroid of the heat in the 5 x 5 around it.

    Differentiable with respect to the heat.
    """
    around, steps = _window(heat, pixels, _REACH)
    total = jnp.maximum(around.sum((1, 2)), 1e-12)
    shift_u = around.sum(1) @ steps / total
    shift_v = around.sum(2) @ steps / total
    return pixels + jnp.stack([shift_u, shift_v], -1)


def hottest_near(
    heat: Float[Array, "8 8 r c"], pixels: Float[Array, "k 2"], *, reach: int
) -> Float[Array, "k 2"]:
    """The pixel (u, v) of the highest heat up to `reach` pixels to each side of each of whole pixels."""
    around, steps = _window(heat, pixels, reach)
    row, column = jnp.divmod(around.reshape(len(pixels), -1).argmax(1), len(steps))
    return pixels + jnp.stack([steps[column], steps[row]], -1)


def _window(
    heat: Float[Array, "8 8 r c"], pixels: Float[Array, "k 2"], reach: int
) -> tuple[Float[Array, "k w w"], Float[Array, " w"]]:
    """The heat around whole pixels, zero beyond the image, and its places from -reach to reach."""
    rows, columns = heat.shape[2:]
    steps = jnp.arange(-reach, reach + 1)
    u, v = pixels.astype(jnp.int32).T
    v, u = v[:, None, None] + steps[:, None], u[:, None, None] + steps
    inside = (v >= 0) & (v < CELL * rows) & (u >= 0) & (u < CELL * columns)
    return jnp.where(inside, _look_up(heat, v, u), 0.0), steps.astype(heat.dtype)


def _look_up(x: Float[Array, "8 8 r c"], v: Int[Array, "*v"], u: Int[Array, "*u"]) -> Float[Array, "..."]:
    return x[v % CELL, u % CELL, v // CELL, u // CELL]


def _running_maximum(x: Float[Array, "8 8 r c"], axis: int) -> Float[Array, "8 8 r c"]:
    """Over two pixels to both sides along image rows (axis 0) or columns (axis 1)."""
    cells = axis + 2
    padded = jnp.pad(x, [(1, 1) if each == cells else (0, 0) for each in range(4)])

    def pixels(place: int) -> Float[Array, "..."]:
        """Those of one place in their cells, or in the cells before or behind."""
        step, place = divmod(place, CELL)
        shifted = lax.slice_in_dim(padded, 1 + step, 1 + step + x.shape[cells], axis=cells)
        return lax.index_in_dim(shifted, place, axis, keepdims=False)

    reach = range(-_REACH, _REACH + 1)
    return jnp.stack(
        [reduce(jnp.maximum, [pixels(place + step) for step in reach]) for place in range(CELL)], axis
    )
