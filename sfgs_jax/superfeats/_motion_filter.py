"""Slope filter of SFGS-SLAM: keeps the matches that move across the image in the same way as most others."""

import math
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.arrays import check_counts, check_range, checked
from sfgs_jax.superfeats._features import Features, Matches
from sfgs_jax.superfeats._matching import (
    MIN_SIMILARITY,
    first_claim,
    first_true,
    gather_matches,
    similarities,
)


@dataclass(frozen=True)
class MotionFilterConfig:
    """Settings of `filter_by_motion`. Two matches agree if their displacements differ by no more than
    `tolerance + relative_tolerance * (mean of their lengths)`.

    Raises:
        InputError: a setting is out of its range.
    """

    tolerance: float = 8.0
    """Pixels by which two displacements may differ at any length, for parallax and noise; at least 0."""

    relative_tolerance: float = 0.25
    """Share of the mean length of two displacements by which they may differ beside `tolerance`; at least 0.
    For small differences it is the angle between them in radians."""

    min_share: float = 0.4
    """Least share of votes of a match that is kept, in [0, 1]. A match gets a vote from each one that agrees
    with it; the share is of the most votes that any match gets."""

    min_matches: int = 20
    """Least number of matches; with fewer, second-best matches that agree with the others are added."""

    min_similarity: float = MIN_SIMILARITY
    """Cosine that a second-best match must exceed, in [0, 1]."""

    def __post_init__(self) -> None:
        check_counts(self, 0, "min_matches")
        check_range(self, 0, math.inf, "tolerance", "relative_tolerance")
        check_range(self, 0, 1, "min_share", "min_similarity")


@checked
def filter_by_motion(
    a: Features, b: Features, matches: Matches, *, config: MotionFilterConfig | None = None
) -> Matches:
    """Slope filter: keep the matches whose displacement between the images agrees with most others.

    Two matches agree if their displacements are close in direction and length together. Each match gets a
    vote from every match that agrees with it, and needs a share of the most votes. If too few are kept,
    unmatched keypoints of image a may take their second most similar keypoint of image b. It must be free,
    and the displacement must agree with those kept.

    The whole image is assumed to move in one way, so this suits small motions. It removes scattered
    mismatches, but also the border of an image that turns about its axis or grows quickly.

    Args:
        a: K keypoints, the first argument of `match`.
        b: M keypoints, the second argument of `match`.
        matches: the result of `match`.
        config: settings, static; `MotionFilterConfig()` if None.

    Source: Wang and Deng, SFGS-SLAM (2025), section 3.1.
    """
    return _filter(a, b, matches, config or MotionFilterConfig())


@partial(jax.jit, static_argnames="config")
def _filter(a: Features, b: Features, matches: Matches, config: MotionFilterConfig) -> Matches:
    motion = _displacements(a, b, matches.index_b, matches.valid)
    votes = _votes(motion, motion, matches.valid, config)
    kept = matches.valid & (votes >= config.min_share * jnp.max(jnp.where(matches.valid, votes, 0)))

    def with_second_best() -> tuple[Int[Array, " k"], Bool[Array, " k"]]:
        second, eligible = _second_best(a, b, matches.index_b, kept, config)
        support = _votes(_displacements(a, b, second, eligible), motion, kept, config)
        needed = jnp.maximum(1.0, config.min_share * jnp.max(jnp.where(kept, votes, 0)))
        eligible &= support >= needed
        index_b = jnp.where(kept, matches.index_b, second)
        taken_in = eligible & first_claim(second, eligible, len(b.valid))
        return index_b, kept | taken_in

    index_b, valid = lax.cond(
        jnp.sum(kept) < config.min_matches, with_second_best, lambda: (matches.index_b, kept)
    )
    return gather_matches(a, b, index_b, valid)


def _displacements(
    a: Features, b: Features, index_b: Int[Array, " k"], valid: Bool[Array, " k"]
) -> Float[Array, "k 2"]:
    """Displacements of the matches, 0 where not valid, without gradients."""
    motion = lax.stop_gradient(b.keypoints[index_b] - a.keypoints)
    return jnp.where(valid[:, None], motion, 0)


def _votes(
    motion: Float[Array, "k 2"],
    voters: Float[Array, "n 2"],
    may_vote: Bool[Array, " n"],
    config: MotionFilterConfig,
) -> Float[Array, " k"]:
    """Number of voters that agree with each displacement."""
    length, voter_length = (jnp.linalg.norm(x, axis=1) for x in (motion, voters))
    limit = config.tolerance + config.relative_tolerance * 0.5 * (length[None] + voter_length[:, None])
    u, v = (motion[None, :, i] - voters[:, None, i] for i in range(2))
    agrees = (u * u + v * v <= limit * limit) & may_vote[:, None]
    return jnp.sum(agrees, axis=0, dtype=motion.dtype)


def _second_best(
    a: Features, b: Features, index_b: Int[Array, " k"], kept: Bool[Array, " k"], config: MotionFilterConfig
) -> tuple[Int[Array, " k"], Bool[Array, " k"]]:
    """Slot in b of each keypoint's second most similar one, and whether both are free and similar enough."""
    table = similarities(a, b)
    table = jnp.where(table == table.max(axis=1)[:, None], 0, table)
    similarity = table.max(axis=1)
    second = first_true(table == similarity[:, None])
    taken = jnp.zeros(len(b.valid), bool).at[jnp.where(kept, index_b, len(b.valid))].set(True, mode="drop")
    return second, ~kept & ~taken[second] & (similarity > config.min_similarity)
