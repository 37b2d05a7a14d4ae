"""Keypoint detection, from the network's logits to sub-pixel positions.

The function `detect` is the algorithm. The others are its steps: heat map by softmax over each cell, maxima
of 5 x 5 windows, the strongest of them, their centroids.

Maps of pixels are kept by place. Element [i, j, r, c] is the pixel in row i and column j of the cell in row r
and column c. So whole maps of cells follow each other in memory, and everything here runs along vectors.
"""

from functools import reduce

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.superfeats.network import CELL

MIN_HEAT = 0.01
"""Default least probability of a keypoint at its pixel."""

_MARGIN = CELL // 2
"""Pixels that the network's first layer sees beyond each cell."""

_REACH = 2
"""Pixels to each side over which a keypoint must be the maximum: a window of 5 x 5."""


def detect(
    logits: Float[Array, "65 r c"],
    reliability: Float[Array, "r c"],
    min_heat: Float[Array, ""] | float = MIN_HEAT,
    *,
    shape: tuple[int, int],
    max_keypoints: int,
) -> tuple[Float[Array, "k 2"], Float[Array, " k"]]:
    """Keypoints of an image, the best first.

    Differentiable through positions and scores; the choice of pixels is not.

    Args:
        logits: of each place in a cell, row by row, and of there being no keypoint.
        reliability: probability, for each cell, that its descriptor finds its counterpart.
        min_heat: least probability of a keypoint at its pixel.
        shape: height and width of the image, which need not fill its cells; static.
        max_keypoints: K, slots for keypoints; static.

    Returns:
        Pixels (u, v), (K, 2), and scores (K,) in [0, 1]: heat times reliability, 0 in empty slots.
    """
    heat = cut(heat_map(logits), *shape)
    chosen = local_maxima(heat) & (heat > min_heat) & away_from_border(heat, *shape)
    scores, pixels = strongest(jnp.where(chosen, heat * reliability[None, None], 0.0), count=max_keypoints)
    return refine(heat, pixels), scores


def heat_map(logits: Float[Array, "65 r c"]) -> Float[Array, "8 8 r c"]:
    """Probability of a keypoint at each pixel: softmax over a cell's 64 places and its dustbin."""
    # Softmax would subtract the maximum first. Without that, the exponentials fuse with the rest.
    weights = jnp.exp(jnp.clip(logits, -80.0, 80.0))
    return (weights[:-1] / weights.sum(0)[None]).reshape(CELL, CELL, *logits.shape[1:])


def cut(heat: Float[Array, "8 8 r c"], height: int, width: int) -> Float[Array, "8 8 r c"]:
    """The heat without the pixels beyond an image of this size, which may not fill its cells."""
    places, (rows, columns) = jnp.arange(CELL), heat.shape[2:]
    if height < CELL * rows:
        inside = CELL * jnp.arange(rows)[None] + places[:, None] < height
        heat = jnp.where(inside[:, None, :, None], heat, 0.0)
    if width < CELL * columns:
        inside = CELL * jnp.arange(columns)[None] + places[:, None] < width
        heat = jnp.where(inside[:, None], heat, 0.0)
    return heat


def away_from_border(heat: Float[Array, "8 8 r c"], height: int, width: int) -> Bool[Array, "8 8 r c"]:
    """Mask of the pixels whose surroundings, as far as the first layer sees them, lie in the image.

    Nearer to the border the network sees where the image ends. Nothing in the scene is there.
    """
    places, (rows, columns) = jnp.arange(CELL), heat.shape[2:]
    v = CELL * jnp.arange(rows)[None] + places[:, None]
    u = CELL * jnp.arange(columns)[None] + places[:, None]
    inside_v, inside_u = ((x >= _MARGIN) & (x < side - _MARGIN) for x, side in ((v, height), (u, width)))
    return inside_v[:, None, :, None] & inside_u[None, :, None]


def local_maxima(heat: Float[Array, "8 8 r c"]) -> Bool[Array, "8 8 r c"]:
    """Non-maximum suppression: mask of the pixels that no other within two pixels exceeds."""
    # Shifted slices fuse into loops; `reduce_window` takes five times longer on a CPU.
    return heat >= _running_maximum(_running_maximum(lax.stop_gradient(heat), 1), 0)


def strongest(
    scores: Float[Array, "8 8 r c"], *, count: int
) -> tuple[Float[Array, " k"], Float[Array, "k 2"]]:
    """The highest scores, in falling order, and their pixels (u, v).

    One pixel of each 2 x 2 square counts. Maxima of 5 x 5 windows lie further apart unless they are equal.

    Args:
        scores: of all pixels.
        count: number of results K, static; scores of 0 fill up.
    """
    # `top_k` takes a third of the time for a quarter of the candidates.
    upper, lower = scores[0::2], scores[1::2]
    squares = jnp.maximum(
        jnp.maximum(upper[:, 0::2], upper[:, 1::2]), jnp.maximum(lower[:, 0::2], lower[:, 1::2])
    )
    found, index = lax.top_k(squares.reshape(-1), min(count, squares.size))
    missing = count - found.size
    found, index = jnp.pad(found, (0, missing)), jnp.pad(index, (0, missing))

    square_v, square_u, r, c = jnp.unravel_index(index, squares.shape)
    v, u = 2 * square_v + CELL * r, 2 * square_u + CELL * c
    four = _look_up(scores, v[:, None] + jnp.array([[0, 0, 1, 1]]), u[:, None] + jnp.array([[0, 1, 0, 1]]))
    place = jnp.argmax(four == found[:, None], axis=1)
    return found, jnp.stack([u + place % 2, v + place // 2], -1).astype(scores.dtype)


def refine(heat: Float[Array, "8 8 r c"], pixels: Float[Array, "k 2"]) -> Float[Array, "k 2"]:
    """Sub-pixel positions: each pixel (u, v) moved to the centroid of the heat in the 5 x 5 around it.

    Differentiable with respect to the heat.
    """
    around, steps = _window(heat, pixels, _REACH)
    total = jnp.maximum(around.sum((1, 2)), 1e-12)
    # In float32 on every device: TF32 would move a keypoint by a thousandth of a pixel.
    highest = lax.Precision.HIGHEST
    shift_u = jnp.matmul(around.sum(1), steps, precision=highest) / total
    shift_v = jnp.matmul(around.sum(2), steps, precision=highest) / total
    return pixels + jnp.stack([shift_u, shift_v], -1)


def hottest_near(
    heat: Float[Array, "8 8 r c"], pixels: Float[Array, "k 2"], *, reach: int
) -> Float[Array, "k 2"]:
    """The hottest pixel in the square window around each of the given ones.

    Args:
        heat: of all pixels.
        pixels: (K, 2) whole pixels (u, v).
        reach: pixels from the middle of the window to its border, static.
    """
    around, steps = _window(heat, pixels, reach)
    row, column = jnp.divmod(around.reshape(len(pixels), -1).argmax(1), len(steps))
    return pixels + jnp.stack([steps[column], steps[row]], -1)


def _window(
    heat: Float[Array, "8 8 r c"], pixels: Float[Array, "k 2"], reach: int
) -> tuple[Float[Array, "k w w"], Float[Array, " w"]]:
    """The heat around whole pixels, 0 beyond the image, and the window's offsets from -reach to reach."""
    rows, columns = heat.shape[2:]
    steps = jnp.arange(-reach, reach + 1)
    u, v = pixels.astype(jnp.int32).T
    v, u = v[:, None, None] + steps[None, :, None], u[:, None, None] + steps[None, None]
    inside = (v >= 0) & (v < CELL * rows) & (u >= 0) & (u < CELL * columns)
    return jnp.where(inside, _look_up(heat, v, u), 0.0), steps.astype(heat.dtype)


def _look_up(x: Float[Array, "8 8 r c"], v: Int[Array, "*v"], u: Int[Array, "*u"]) -> Float[Array, "..."]:
    """Values at pixels (row v, column u)."""
    return x[v % CELL, u % CELL, v // CELL, u // CELL]


def _running_maximum(x: Float[Array, "8 8 r c"], axis: int) -> Float[Array, "8 8 r c"]:
    """Maximum over `_REACH` pixels to both sides, down the image (axis 0) or across it (axis 1)."""
    cells = axis + 2
    padded = jnp.pad(x, [(1, 1) if each == cells else (0, 0) for each in range(4)])

    def pixels(place: int) -> Float[Array, "..."]:
        """Pixels of one place in every cell; negative places lie in the cell before, from 8 on behind."""
        step, place = divmod(place, CELL)
        shifted = lax.slice_in_dim(padded, 1 + step, 1 + step + x.shape[cells], axis=cells)
        return lax.index_in_dim(shifted, place, axis, keepdims=False)

    reach = range(-_REACH, _REACH + 1)
    return jnp.stack(
        [reduce(jnp.maximum, [pixels(place + step) for step in reach]) for place in range(CELL)], axis
    )
