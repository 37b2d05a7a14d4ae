"""Which keypoints of two images belong together."""

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Scalar

from sfgs_jax.geometry import InputError
from sfgs_jax.superfeats.features import Features, Matches

MIN_SIMILARITY = 0.75
"""Descriptors less alike than this are seldom of one point. Of the right matches of blurred views it keeps as
many as XFeat's floor of 0.82 does of XFeat's (experiments/similarity_floor.py)."""

_ROWS = 256


def match(a: Features, b: Features, *, min_similarity: float | Scalar = MIN_SIMILARITY) -> Matches:
    """Mutual nearest neighbours: each is the other's most similar descriptor, and they are similar enough.

    No keypoint of either image is in two matches: of equally similar ones the first wins. The similarities
    have gradients with respect to the descriptors; the choice of neighbours has none.

    Args:
        a: K keypoints.
        b: M keypoints, with descriptors of the same length.
        min_similarity: cosine that a match must exceed, from 0 to 1. A new value does not compile anew.

    Raises:
        InputError: descriptors differ in length, or `min_similarity` lies outside [0, 1].
    """
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
    # Of equal descriptors each would be the nearest.
    mutual &= first_claim(index_b, mutual, len(b.valid))
    return gather_matches(a, b, index_b, mutual & (similarity > min_similarity))


def _nearest(a: Features, b: Features) -> tuple[Float[Array, " k"], Int[Array, " k"], Bool[Array, " k"]]:
    """Each of a's keypoints' highest cosine, where in b it is, and whether it is the highest there too.

    The table of cosines is made and used some rows at a time, so that it stays in the cache.
    """
    left, right = _clean_descriptors(a), _clean_descriptors(b)
    count = len(left)
    blocks = jnp.pad(left, ((0, -count % _ROWS), (0, 0))).reshape(-1, _ROWS, left.shape[1])

    def step(best_of_column: Array, rows: Array) -> tuple[Array, tuple[Array, Array]]:
        table = rows @ right.T
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
    return _clean_descriptors(a) @ _clean_descriptors(b).T


def first_true(table: Bool[Array, "k m"], *, axis: int = 1) -> Int[Array, " n"]:
    """Where along the axis each row (or column) is first true, or the axis' length where it is nowhere.

    Compared with its maxima, a table tells where they are in a fraction of the time that XLA's argmax takes
    on a CPU.
    """
    places = lax.broadcasted_iota(int, table.shape, axis)
    return jnp.min(jnp.where(table, places, table.shape[axis]), axis=axis)


def first_claim(index_b: Int[Array, " k"], found: Bool[Array, " k"], columns: int) -> Bool[Array, " k"]:
    """Whether no earlier row has found the same column."""
    rows = jnp.arange(len(index_b))
    nobody = len(index_b)
    owner = jnp.full(columns, nobody).at[jnp.where(found, index_b, columns)].min(rows, mode="drop")
    return owner.at[index_b].get(mode="clip") == rows


def gather_matches(a: Features, b: Features, index_b: Int[Array, " k"], valid: Bool[Array, " k"]) -> Matches:
    """Matches of the given slots, with their similarities, which have gradients."""
    index_b = jnp.where(valid, index_b, 0)
    left = jnp.where(valid[:, None], a.descriptors, 0)
    right = jnp.where(valid[:, None], b.descriptors[index_b], 0)
    return Matches(index_b, jnp.sum(left * right, axis=1), valid)
