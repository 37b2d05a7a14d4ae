"""One training step of SuperFeats, a pure function of its state and a batch."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.arrays import InputError, checked
from sfgs_jax.superfeats._descriptors import cosines, sample, unit
from sfgs_jax.superfeats.network import CELL, BatchStatistics, DenseFeatures, Network, forward
from sfgs_jax.superfeats.training._losses import (
    contrastive_keypoint_loss,
    dual_softmax_loss,
    heat_loss,
    hinge_descriptor_loss,
    imitation_loss,
    keypoint_positions,
    reliability_loss,
    reprojection_loss,
)


class Batch(eqx.Module):
    """B pairs of views with a teacher's labels and known correspondences.

    Attributes:
        images: (B, 2, S, S) normalised grey images.
        heat: (B, 2, S/8, S/8, 65) probabilities of a keypoint at each place of a cell, and of none.
        descriptors: (B, 2, S/8, S/8, 64) a teacher's descriptors, of unit length.
        reliability: (B, 2, S/8, S/8) a teacher's reliability, in [0, 1].
        labelled: (B, 2, S/8, S/8) weight of each cell's labels.
        points: (B, 2, N, 2) pixels (u, v) of the same points in both views.
        seen: (B, N) which points are seen in both views.
        H_b_a: (B, 3, 3) takes pixels of the first view to the second's; only planar pairs use it.
        planar: (B,) 1 for two views of one plane, 0 for other pairs.
        hidden: (B, 2, S, S) pixels where something covers the scene.
    """

    images: Float[Array, "b 2 s s"]
    heat: Float[Array, "b 2 c c 65"]
    descriptors: Float[Array, "b 2 c c d"]
    reliability: Float[Array, "b 2 c c"]
    labelled: Float[Array, "b 2 c c"]
    points: Float[Array, "b 2 n 2"]
    seen: Bool[Array, "b n"]
    H_b_a: Float[Array, "b 3 3"]
    planar: Float[Array, " b"]
    hidden: Bool[Array, "b 2 s s"]


@dataclass(frozen=True)
class LossWeights:
    """Weights of the losses in their sum.

    Raises:
        InputError: a weight is negative.
    """

    heat: float = 1.0
    """Weight of `heat_loss`; 0 leaves it out."""

    reprojection: float = 3.0
    """Weight of `reprojection_loss` over planar pairs; 0 leaves it out."""

    contrast: float = 0.0
    """Weight of `contrastive_keypoint_loss`; 0 leaves it out."""

    hinge: float = 0.0
    """Weight of `hinge_descriptor_loss`; 0 leaves it out."""

    dual_softmax: float = 0.5
    """Weight of `dual_softmax_loss`; 0 leaves it out."""

    imitation: float = 4.0
    """Weight of `imitation_loss`; 0 leaves it out."""

    reliability: float = 0.2
    """Weight of `reliability_loss`; 0 leaves it out."""

    def __post_init__(self) -> None:
        if not all(getattr(self, each.name) >= 0 for each in fields(self)):
            raise InputError(f"{self}: the weights of losses must not be negative.")


class TrainingState(eqx.Module):
    """Everything that a training run needs to be continued.

    Attributes:
        network: with batch normalisations.
        optimiser: state of the optimiser.
        step: number of steps taken.
    """

    network: Network
    optimiser: optax.OptState
    step: Int[Array, ""]


@checked
def initial_state(network: Network, optimiser: optax.GradientTransformation) -> TrainingState:
    """The state before the first step.

    Args:
        network: with batch normalisations, `initialise_network(key)`.
        optimiser: the one that `train_step` will use.
    """
    return TrainingState(
        network=network,
        optimiser=optimiser.init(eqx.filter(network, eqx.is_array)),
        step=jnp.zeros((), jnp.int32),
    )


@checked
def losses(
    dense: DenseFeatures, batch: Batch, weights: LossWeights
) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    """Weighted sum of all losses, and figures by name.

    Args:
        dense: outputs of the network for the batch's 2 B views, pair after pair.
        batch: labels and correspondences.
        weights: of the losses, static.

    Returns:
        The sum, and a dictionary with the sum (`loss`), each loss, and the share of points whose nearest
        neighbour among the other view's points is the right one (`accuracy`).
    """
    count = batch.images.shape[0]
    logits, descriptors, reliability = (
        x.reshape(count, 2, *x.shape[1:]) for x in (dense.logits, dense.descriptors, dense.reliability)
    )
    sampled = unit(jax.vmap(jax.vmap(sample))(descriptors, batch.points))
    a, b = sampled[:, 0], sampled[:, 1]
    per_view = partial(_mean_over, axes=2)
    per_pair = partial(_mean_over, axes=1)
    figures = {
        "heat": per_view(heat_loss, logits, batch.heat, batch.labelled),
        "reprojection": _reprojection(logits, batch),
        "contrast": per_pair(_contrast, logits, batch.points, batch.seen),
        "hinge": per_pair(hinge_descriptor_loss, a, b, batch.points[:, 1], batch.points[:, 1], batch.seen),
        "dual_softmax": per_pair(dual_softmax_loss, a, b, batch.seen),
        "imitation": per_view(imitation_loss, descriptors, batch.descriptors, batch.labelled),
        "reliability": per_view(reliability_loss, reliability, batch.reliability, batch.labelled),
    }
    total = sum(
        (getattr(weights, name) * value for name, value in figures.items() if getattr(weights, name) > 0),
        start=jnp.zeros(()),
    )
    return total, {"loss": total, **figures, "accuracy": per_pair(_accuracy, a, b, batch.seen)}


@checked
@partial(jax.jit, static_argnames=("optimiser", "weights"), donate_argnums=0)
def train_step(
    state: TrainingState,
    batch: Batch,
    *,
    optimiser: optax.GradientTransformation,
    weights: LossWeights,
) -> tuple[TrainingState, dict[str, Float[Array, ""]]]:
    """One step of the optimiser; the given state's memory is reused (donated).

    Data-parallel training: the batch may be laid out over several devices along its first axis, with the
    state on all of them. Losses and batch statistics are of the whole batch.

    Args:
        state: before the step; it can't be used afterwards.
        batch: pairs of views.
        optimiser: the one that the state was made for, static.
        weights: of the losses, static.

    Returns:
        The state after the step, and the figures of `losses` before it.
    """

    def loss(network: Network):
        statistics = BatchStatistics()
        dense = forward(network, _views(batch), statistics)
        total, figures = losses(dense, batch, weights)
        return total, (figures, statistics.updated(network))

    gradient, (figures, network) = jax.grad(loss, has_aux=True)(state.network)
    updates, optimiser_state = optimiser.update(gradient, state.optimiser, cast(Any, state.network))
    # The running statistics have no gradient, so the optimiser changes the weights alone.
    after = TrainingState(
        network=eqx.apply_updates(network, updates), optimiser=optimiser_state, step=state.step + 1
    )
    return after, figures


@checked
@partial(jax.jit, static_argnames="weights")
def evaluate(network: Network, batch: Batch, *, weights: LossWeights) -> dict[str, Float[Array, ""]]:
    """The figures of `losses` for a folded network.

    Args:
        network: folded.
        batch: pairs of views.
        weights: of the losses, static.
    """
    return losses(forward(network, _views(batch)), batch, weights)[1]


def _views(batch: Batch) -> Float[Array, "b2 s s"]:
    """All views of the batch, pair after pair."""
    return batch.images.reshape(-1, *batch.images.shape[2:])


def _mean_over(function: Callable[..., Array], *arguments: Array, axes: int) -> Float[Array, ""]:
    """Mean of a function over the first axes of its arguments."""
    for _ in range(axes):
        function = jax.vmap(function)
    return function(*arguments).mean()


def _reprojection(logits: Float[Array, "b 2 c c 65"], batch: Batch) -> Float[Array, ""]:
    """Mean of `reprojection_loss` in both directions, over the planar pairs."""
    one_way = jax.vmap(reprojection_loss)
    a, b = logits[:, 0], logits[:, 1]
    hidden_a, hidden_b = batch.hidden[:, 0], batch.hidden[:, 1]
    there = one_way(a, b, batch.H_b_a, hidden_a, hidden_b)
    back = one_way(b, a, jnp.linalg.inv(batch.H_b_a), hidden_b, hidden_a)
    return ((there + back) * batch.planar).sum() / jnp.maximum(batch.planar.sum(), 1)


def _contrast(
    logits: Float[Array, "2 c c 65"], points: Float[Array, "2 n 2"], seen: Bool[Array, " n"]
) -> Float[Array, ""]:
    """`contrastive_keypoint_loss` between the keypoints of cells that show the same point in both views.

    Each keypoint is paired with its counterpart (the same), and with the next point's (not the same).
    """
    found = jax.vmap(keypoint_positions)(logits)
    cells = jnp.clip((points / CELL).astype(jnp.int32), 0, logits.shape[1] - 1)
    in_a, in_b = (found[view, cells[view, :, 1], cells[view, :, 0]] for view in (0, 1))
    # Within a cell the change of view is taken for a shift, which carries the first view's keypoint over.
    counterparts = points[1] + (in_a - points[0])
    others = jnp.roll(in_b, 1, axis=0)
    weights = seen.astype(logits.dtype)
    same = contrastive_keypoint_loss(in_b, counterparts, jnp.ones_like(seen), weights)
    other = contrastive_keypoint_loss(others, counterparts, jnp.zeros_like(seen), weights)
    return same + other


def _accuracy(a: Float[Array, "n d"], b: Float[Array, "n d"], seen: Bool[Array, " n"]) -> Float[Array, ""]:
    """Share of the seen points whose nearest neighbour is the right one."""
    similarity = jnp.where(seen[None], cosines(a, b), -2.0)
    right = jnp.diagonal(similarity) >= similarity.max(axis=1)
    return (right & seen).sum() / jnp.maximum(seen.sum(), 1)
