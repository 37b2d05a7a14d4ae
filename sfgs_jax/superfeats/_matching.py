"""Matching of keypoints: mutual nearest neighbours by cosine similarity."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Scalar

from sfgs_jax.arrays import InputError, checked_but, described
from sfgs_jax.superfeats._descriptors import cosines
from sfgs_jax.superfeats._features import Features, Matches

MIN_SIMILARITY = 0.75
"""Default floor for the cosine of a match. In blurred views it keeps the same share of right matches that
XFeat's floor of 0.82 keeps of XFeat's (experiments/similarity_floor.py)."""

_ROWS = 256
"""Rows of the table of cosines that are made and used at a time, so that they stay in the cache."""


class Expected(eqx.Module):
    """Places in image a where the keypoints of image b should lie, by a motion that is roughly known.

    Keypoints on texture that repeats itself, such as tiles, look alike, and only their places tell them
    apart. A pair loses some of its similarity by lying elsewhere, by the square of the distance, and beyond
    `reach` no more than `penalty`. So places decide between keypoints that look alike. A motion that was not
    expected is still found where keypoints differ.

    Attributes:
        pixels: (M, 2) places (u, v) in image a.
        reach: distance in pixels from which on a pair loses the whole penalty.
        penalty: the most that the cosine of a pair counts less.
    """

    pixels: Float[Array, "m 2"]
    reach: float | Scalar
    penalty: float | Scalar


@checked_but("a", "b")
def match(
    a: Features,
    b: Features,
    *,
    min_similarity: float | Scalar = MIN_SIMILARITY,
    expected: Expected | None = None,
) -> Matches:
    """Mutual nearest neighbours: each is the other's most similar descriptor, and they are similar enough.

    No keypoint of either image is in two matches; among equally similar ones the first wins. The similarities
    have gradients with respect to the descriptors; the choice of neighbours has none.

    Args:
        a: K keypoints.
        b: M keypoints, with descriptors of the same length.
        min_similarity: cosine that a match must exceed, from 0 to 1. A new value does not compile anew.
        expected: places of b's keypoints in image a, where the motion is known; they help to choose
            neighbours. The similarities of the matches, and their floor, are without the penalty.

    Raises:
        InputError: descriptors differ in length, or `min_similarity` lies outside [0, 1].
    """
    for features in (a, b):
        if not isinstance(features, Features):
            raise InputError(f"a and b are Features, not {described(features)}.")
    lengths = a.descriptors.shape[1], b.descriptors.shape[1]
    if lengths[0] != lengths[1]:
        raise InputError(
            f"Descriptors of {lengths[0]} and {lengths[1]} numbers cannot be compared: "
            "take both images' features from one extractor."
        )
    if isinstance(min_similarity, float | int) and not 0 <= min_similarity <= 1:
        raise InputError(f"min_similarity is a cosine from 0 to 1, not {min_similarity}.")
    return _match(a, b, jnp.asarray(min_similarity, a.descriptors.dtype), expected)


@jax.jit
def _match(a: Features, b: Features, min_similarity: Scalar, expected: Expected | None) -> Matches:
    index_b, mutual = _nearest(a, b, lax.stop_gradient(expected))
    mutual &= a.valid & b.valid[index_b]
    # Several equal descriptors are all nearest neighbours of one; the first keeps it.
    mutual &= first_claim(index_b, mutual, len(b.valid))
    nearest = gather_matches(a, b, index_b, mutual)
    valid = nearest.valid & (nearest.similarity > min_similarity)
    return jax.tree.map(lambda x: jnp.where(valid, x, jnp.zeros((), x.dtype)), nearest)


def _nearest(
    a: Features, b: Features, expected: Expected | None
) -> tuple[Int[Array, " k"], Bool[Array, " k"]]:
    """Nearest neighbours in b of a's keypoints, less the penalties of pairs that lie elsewhere.

    Returns:
        The slot in b (K,) of the nearest, and whether a's keypoint is the nearest of that slot too (K,).
    """
    right, count = _clean_descriptors(b), len(a.valid)

    def blocks(x: Array) -> Array:
        return jnp.pad(x, ((0, -count % _ROWS), (0, 0))).reshape(-1, _ROWS, x.shape[1])

    def step(best_of_column: Array, block: tuple[Array, Array]) -> tuple[Array, tuple[Array, Array]]:
        rows, pixels = block
        table = cosines(rows, right)
        if expected is not None:
            table -= _penalties(pixels, expected)
        best_of_row = table.max(axis=1)
        found = best_of_row, first_true(table == best_of_row[:, None])
        return jnp.maximum(best_of_column, table.max(axis=0)), found

    nothing = jnp.full(len(right), -jnp.inf, right.dtype)
    places = jnp.where(a.valid[:, None], a.keypoints, 0)
    best_of_column, nearest = lax.scan(step, nothing, (blocks(_clean_descriptors(a)), blocks(places)))
    best, index_b = (values.reshape(-1)[:count] for values in nearest)
    return index_b, best == best_of_column[index_b]


def _penalties(pixels: Float[Array, "k 2"], expected: Expected) -> Float[Array, "k m"]:
    """Penalty of each pair's cosine: all of it far away, and where the place is unknown."""
    square = sum((pixels[:, axis, None] - expected.pixels[None, :, axis]) ** 2 for axis in (0, 1))
    share = square / expected.reach**2
    return expected.penalty * jnp.where(share < 1, share, 1)


def _clean_descriptors(features: Features) -> Float[Array, "k d"]:
    """Descriptors without gradients, and zeros in empty slots, which no floor of 0 or more lets match."""
    return lax.stop_gradient(jnp.where(features.valid[:, None], features.descriptors, 0))


def similarities(a: Features, b: Features) -> Float[Array, "k m"]:
    """Cosines of all pairs, without gradients; those of empty slots are 0."""
    return cosines(_clean_descriptors(a), _clean_descriptors(b))


def first_true(table: Bool[Array, "k m"], *, axis: int = 1) -> Int[Array, " n"]:
    """Position of the first True in each row (axis 1) or column (axis 0), or the axis' length.

    With a table compared to its maxima this is an argmax, several times faster than XLA's on a CPU.
    """
    places = lax.broadcasted_iota(int, table.shape, axis)
    return jnp.min(jnp.where(table, places, table.shape[axis]), axis=axis)


def first_claim(index_b: Int[Array, " k"], found: Bool[Array, " k"], columns: int) -> Bool[Array, " k"]:
    """Mask of the rows that are the first to have found their column.

    Args:
        index_b: (K,) column that each row has found.
        found: (K,) which rows count.
        columns: number of columns.
    """
    rows = jnp.arange(len(index_b))
    nobody = len(index_b)
    owner = jnp.full(columns, nobody).at[jnp.where(found, index_b, columns)].min(rows, mode="drop")
    return owner.at[index_b].get(mode="clip") == rows


def gather_matches(a: Features, b: Features, index_b: Int[Array, " k"], valid: Bool[Array, " k"]) -> Matches:
    """Matches of the given slots, with differentiable similarities.

    Args:
        a: K keypoints.
        b: M keypoints.
        index_b: (K,) slot in b for each slot in a.
        valid: (K,) which slots in a are matched.
    """
    index_b = jnp.where(valid, index_b, 0)
    left = jnp.where(valid[:, None], a.descriptors, 0)
    right = jnp.where(valid[:, None], b.descriptors[index_b], 0)
    return Matches(index_b=index_b, similarity=jnp.sum(left * right, axis=1), valid=valid)
