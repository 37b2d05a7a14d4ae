"""Matches that move across the image as the others do."""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.superfeats.features import Features, Matches
from sfgs_jax.superfeats.matching import MIN_SIMILARITY, first_claim, first_true, gather_matches, similarities


@dataclass(frozen=True)
class MotionFilterConfig:
    """What it means that two matches move alike."""

    tolerance: float = 8.0
    """Pixels by which two displacements may differ in any case: parallax and localisation."""
    relative_tolerance: float = 0.25
    """And by this share of their mean length: about the radians of direction, and the share of length."""
    min_share: float = 0.4
    """A match is kept if it agrees with this share of the matches that the best one agrees with."""
    min_matches: int = 20
    """With fewer than this many kept, second-best matches that agree with them are taken in."""
    min_similarity: float = MIN_SIMILARITY
    """Cosine that a second-best match must exceed, at least 0."""


def filter_by_motion(
    a: Features, b: Features, matches: Matches, *, config: MotionFilterConfig | None = None
) -> Matches:
    """The matches whose slope, the way from the position in one image to that in the other, agrees best.

    Two matches agree if their displacements, direction and length together, are close. The one that agrees
    with most others sets the standard. Where too few are kept, each unmatched keypoint of image a may take
    its second most similar keypoint of image b, if nothing else has that and the displacement agrees with
    those kept. A single motion of the image as a whole is assumed, so this suits small motions: it removes
    scattered mismatches, but also the border of an image that turns about its axis or grows quickly.

    Source: Wang and Deng, SFGS-SLAM (2025), section 3.1.

    Args:
        a: K keypoints, as given to `match`.
        b: M keypoints, as given to `match`.
        matches: what `match` returned.
        config: settings, `MotionFilterConfig()` if not given.
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
    motion = lax.stop_gradient(b.keypoints[index_b] - a.keypoints)
    return jnp.where(valid[:, None], motion, 0)


def _votes(
    motion: Float[Array, "k 2"],
    voters: Float[Array, "n 2"],
    may_vote: Bool[Array, " n"],
    config: MotionFilterConfig,
) -> Float[Array, " k"]:
    """With how many of the voters each displacement agrees."""
    length, voter_length = (jnp.linalg.norm(x, axis=1) for x in (motion, voters))
    limit = config.tolerance + config.relative_tolerance * 0.5 * (length + voter_length[:, None])
    u, v = (motion[:, i] - voters[:, None, i] for i in range(2))
    agrees = (u * u + v * v <= limit * limit) & may_vote[:, None]
    return jnp.sum(agrees, axis=0, dtype=motion.dtype)


def _second_best(
    a: Features, b: Features, index_b: Int[Array, " k"], kept: Bool[Array, " k"], config: MotionFilterConfig
) -> tuple[Int[Array, " k"], Bool[Array, " k"]]:
    """Each keypoint's second most similar one in image b, and whether both are free and similar enough."""
    table = similarities(a, b)
    table = jnp.where(table == table.max(axis=1)[:, None], 0, table)
    similarity = table.max(axis=1)
    second = first_true(table == similarity[:, None])
    taken = jnp.zeros(len(b.valid), bool).at[jnp.where(kept, index_b, len(b.valid))].set(True, mode="drop")
    return second, ~kept & ~taken[second] & (similarity > config.min_similarity)
