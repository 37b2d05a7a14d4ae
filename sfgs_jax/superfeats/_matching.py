"""Matching of keypoints: mutual nearest neighbours by cosine similarity."""

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Scalar

from sfgs_jax.arrays import InputError, described
from sfgs_jax.superfeats._descriptors import cosines
from sfgs_jax.superfeats._features import Features, Matches

MIN_SIMILARITY = 0.75
"""Default floor for the cosine of a match. In blurred views it keeps the same share of right matches that
XFeat's floor of 0.82 keeps of XFeat's (experiments/similarity_floor.py)."""

_ROWS = 256
"""Rows of the table of cosines that are made and used at a time, so that they stay in the cache."""


def match(a: Features, b: Features, *, min_similarity: float | Scalar = MIN_SIMILARITY) -> Matches:
    """Mutual nearest neighbours: each is the other's most similar descriptor, and they are similar enough.

    No keypoint of either image is in two matches; among equally similar ones the first wins. The similarities
    have gradients with respect to the descriptors; the choice of neighbours has none.

    Args:
        a: K keypoints.
        b: M keypoints, with descriptors of the same length.
        min_similarity: cosine that a match must exceed, from 0 to 1. A new value does not compile anew.

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
    return _match(a, b, jnp.asarray(min_similarity, a.descriptors.dtype))


@jax.jit
def _match(a: Features, b: Features, min_similarity: Scalar) -> Matches:
    similarity, index_b, mutual = _nearest(a, b)
    # Several equal descriptors are all nearest neighbours of one; the first keeps it.
    mutual &= first_claim(index_b, mutual, len(b.valid))
    return gather_matches(a, b, index_b, mutual & (similarity > min_similarity))


def _nearest(a: Features, b: Features) -> tuple[Float[Array, " k"], Int[Array, " k"], Bool[Array, " k"]]:
    """Nearest neighbours in b of a's keypoints.

    Returns:
        The highest cosine (K,), the slot in b (K,) that has it, and whether the slot has no higher one (K,).
    """
    left, right = _clean_descriptors(a), _clean_descriptors(b)
    count = len(left)
    blocks = jnp.pad(left, ((0, -count % _ROWS), (0, 0))).reshape(-1, _ROWS, left.shape[1])

    def step(best_of_column: Array, rows: Array) -> tuple[Array, tuple[Array, Array]]:
        table = cosines(rows, right)
        best_of_row = table.max(axis=1)
        found = best_of_row, first_true(table == best_of_row[:, None])
        return jnp.maximum(best_of_column, table.max(axis=0)), found

    best_of_column, nearest = lax.scan(step, jnp.full(len(right), -jnp.inf, right.dtype), blocks)
    similarity, index_b = (values.reshape(-1)[:count] for values in nearest)
    return similarity, index_b, similarity == best_of_column[index_b]


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
