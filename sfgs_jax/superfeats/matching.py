"""Which keypoints of two images belong together."""

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Scalar

from sfgs_jax.geometry import InputError
from sfgs_jax.superfeats.features import Features, Matches

MIN_SIMILARITY = 0.82
"""XFeat's floor: descriptors less alike than this are seldom of one point."""


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
    table = similarities(a, b)
    columns = table.shape[1]
    best_of_row, best_of_column = table.max(axis=1), table.max(axis=0)
    index_b = first_true((table == best_of_row[:, None]) & (table == best_of_column))
    found = (index_b < columns) & (best_of_row > min_similarity)
    return gather_matches(a, b, index_b, found & first_claim(index_b, found, columns))


def similarities(a: Features, b: Features) -> Float[Array, "k m"]:
    """Cosines of all pairs; those of empty slots are 0, so no floor of 0 or more lets them match."""
    left, right = (jnp.where(x.valid[:, None], x.descriptors, 0) for x in (a, b))
    return lax.stop_gradient(left @ right.T)


def first_true(table: Bool[Array, "k m"]) -> Int[Array, " k"]:
    """The first column where each row is true, or m where it is nowhere.

    Compared with its maximum, a table gives each row's best column in a fifth of the time that XLA's argmax
    takes on a CPU.
    """
    columns = table.shape[1]
    return jnp.min(jnp.where(table, jnp.arange(columns), columns), axis=1)


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
