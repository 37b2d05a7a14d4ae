"""Train SuperFeats with XFeat's labels.

    python -m experiments.train_superfeats runs/superfeats --steps 20000

Writes weights, a log of figures and a plot. Started again with the same folder, training continues after the
last checkpoint and sees the same batches. Several JAX devices share each batch.
"""

import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Literal

import equinox as eqx
import jax
import matplotlib
import numpy as np
import optax
import tyro
from jax.sharding import AxisType, NamedSharding, PartitionSpec
from rich.progress import track

from experiments.superfeats_pairs import Photos, RecordingPairs, Scenes, batches, held_out
from experiments.xfeat import XFeat, default_weights
from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import read_photos
from sfgs_jax.superfeats.network import Network, NetworkConfig, fold, initialise_network, save_weights
from sfgs_jax.superfeats.training import (
    Batch,
    LossWeights,
    TrainingState,
    evaluate,
    initial_state,
    train_step,
)

matplotlib.use("agg")
import matplotlib.pyplot as plt

_TRAINING_FRAMES = (0, 260)
"""Frames of the project's recording for training; its second half is for judging."""

_VALIDATION_FRAMES = (260, 300)
"""Frames of the project's recording for validation."""


@dataclass(frozen=True)
class TrainingConfig:
    """Settings of a training run.

    Raises:
        InputError: a setting is out of its range.
    """

    out: tyro.conf.Positional[Path]
    """Folder of the run: checkpoint.eqx, weights.safetensors, log.jsonl, curves.png."""

    steps: int = 20_000
    """Steps in all, more than `warm_up`. The learning rate falls over them; a restart with another number
    changes the rest of its fall."""

    pairs: int = 4
    """Pairs in a batch; even, and a multiple of the number of devices."""

    learning_rate: float = 2e-3
    """Highest learning rate, positive. It falls to a hundredth of this along a cosine."""

    warm_up: int = 200
    """Steps over which the learning rate rises from 0."""

    seed: int = 0
    """Seed of the first weights and of the batches."""

    save_every: int = 250
    """Steps from one checkpoint, with its validation, to the next; positive."""

    validation_batches: int = 8
    """Batches of held-out pairs that each validation averages; positive."""

    recording_share: float = 0.35
    """Share of pairs from the recording, in [0, 1]; 0 leaves it out."""

    data: Path = field(default_factory=lambda: default_weights().parents[1] / "data")
    """Folder with photos/ and 7scenes/redkitchen/."""

    photos: Path | None = None
    """Folder of other photographs than those in photos/."""

    layout: Literal["folder", "coco", "megadepth"] = "folder"
    """Layout of the folder of photographs."""

    description_from: Path | None = None
    """File checkpoint.eqx of a run with the same widths, whose description branch this one starts from."""

    weights: LossWeights = field(default_factory=LossWeights)
    """Weights of the losses."""

    network: NetworkConfig = field(default_factory=NetworkConfig)
    """Widths of the network."""

    def __post_init__(self) -> None:
        if not 0 <= self.warm_up < self.steps:
            raise InputError(f"{self.steps} steps leave none after the {self.warm_up} of the warm-up.")
        if self.pairs < 2 or self.pairs % 2:
            raise InputError(f"A batch needs a positive even number of pairs, not {self.pairs}.")
        if min(self.save_every, self.validation_batches) < 1 or self.learning_rate <= 0:
            raise InputError(
                f"save_every ({self.save_every}), validation_batches ({self.validation_batches}) and "
                f"learning_rate ({self.learning_rate}) must be positive."
            )
        if not 0 <= self.recording_share <= 1:
            raise InputError(f"recording_share is a share from 0 to 1, not {self.recording_share}.")


def train(config: TrainingConfig) -> None:
    """Train until `config.steps`, from the last checkpoint if there is one."""
    config.out.mkdir(parents=True, exist_ok=True)
    teacher = XFeat(threads=1)
    photos = sorted(read_photos(config.photos or config.data / "photos", layout=config.layout).paths)
    judged = held_out(photos)
    validation = _take(_scenes(config, judged, _VALIDATION_FRAMES), teacher, config)
    scenes = _scenes(config, sorted({*photos} - {*judged}), _TRAINING_FRAMES)

    optimiser = _optimiser(config.learning_rate, config.warm_up, config.steps)
    state = initial_state(first_network(config), optimiser)
    checkpoint = config.out / "checkpoint.eqx"
    if checkpoint.exists():
        state = eqx.tree_deserialise_leaves(checkpoint, state)
    first = int(state.step)

    mesh = jax.make_mesh((jax.device_count(),), ("data",), axis_types=(AxisType.Auto,))
    by_pairs, everywhere = (NamedSharding(mesh, PartitionSpec(*axes)) for axes in (("data",), ()))
    state = jax.device_put(state, everywhere)
    stream = batches(scenes, teacher, pairs=config.pairs, seed=config.seed + 1, first=first)
    recent: list[dict[str, float]] = []
    started = time.perf_counter()
    for step in track(range(first + 1, config.steps + 1), description=f"Training from step {first}"):
        batch = jax.device_put(next(stream), by_pairs)
        state, figures = train_step(state, batch, optimiser=optimiser, weights=config.weights)
        recent.append({name: float(value) for name, value in figures.items()})
        if not np.isfinite(recent[-1]["loss"]):
            raise FloatingPointError(
                f"The loss of step {step} is not finite; {checkpoint} is from before it."
            )
        if step % config.save_every == 0 or step == config.steps:
            seconds = (time.perf_counter() - started) / (step - first)
            entry = {
                "step": step,
                "seconds_per_step": round(seconds, 4),
                "training": _mean(recent),
                "validation": _validate(state, validation, config.weights),
            }
            recent = []
            save_checkpoint(config, state, entry)


@cache
def _optimiser(learning_rate: float, warm_up: int, steps: int) -> optax.GradientTransformation:
    """Adam with warm-up and cosine decay; one object for the same settings, so that runs share a program."""
    schedule = optax.warmup_cosine_decay_schedule(0.0, learning_rate, warm_up, steps, learning_rate / 100)
    return optax.chain(optax.clip_by_global_norm(1.0), optax.adam(schedule))


def first_network(config: TrainingConfig) -> Network:
    """The network before the first step: random, or with another run's description branch."""
    network = initialise_network(jax.random.key(config.seed), config.network)
    if config.description_from is None:
        return network

    def description(network: Network) -> tuple:
        return network.levels, network.fusions, network.describe, network.rely

    # The description branch comes first in a checkpoint, so the detection branch there may be another.
    known = eqx.tree_deserialise_leaves(config.description_from, description(network))
    return eqx.tree_at(description, network, known)


def _scenes(
    config: TrainingConfig, photos: Sequence[Path], frames: tuple[int, int]
) -> list[tuple[float, Scenes]]:
    scenes: list[tuple[float, Scenes]] = [(1 - config.recording_share, Photos(photos))]
    if config.recording_share > 0:
        source = config.data / "7scenes" / "redkitchen"
        scenes.append((config.recording_share, RecordingPairs(source, start=frames[0], end=frames[1])))
    return scenes


def _take(scenes: list[tuple[float, Scenes]], teacher: XFeat, config: TrainingConfig) -> list[Batch]:
    stream = batches(scenes, teacher, pairs=config.pairs, seed=0)
    return [next(stream) for _ in range(config.validation_batches)]


def _validate(state: TrainingState, validation: list[Batch], weights: LossWeights) -> dict[str, float]:
    network = fold(state.network)
    figures = [evaluate(network, batch, weights=weights) for batch in validation]
    return _mean([{name: float(value) for name, value in entry.items()} for entry in figures])


def _mean(figures: list[dict[str, float]]) -> dict[str, float]:
    return {name: round(float(np.mean([entry[name] for entry in figures])), 5) for name in figures[0]}


def save_checkpoint(config: TrainingConfig, state: TrainingState, entry: dict) -> None:
    """Write weights, log, settings and plot, then the checkpoint; after a stop in between, all are repeated.

    Args:
        config: settings of the run.
        state: after the step.
        entry: the step's figures, for the log.
    """
    save_weights(config.out / "weights.safetensors", state.network)
    with (config.out / "log.jsonl").open("a") as log:
        log.write(json.dumps(entry) + "\n")
    (config.out / "config.json").write_text(json.dumps(asdict(config), indent=2, default=str))
    _plot(config.out)
    fresh = config.out / "checkpoint.new"
    eqx.tree_serialise_leaves(fresh, jax.device_get(state))
    fresh.replace(config.out / "checkpoint.eqx")
    print(json.dumps(entry), flush=True)


def _plot(out: Path) -> None:
    lines = (out / "log.jsonl").read_text().splitlines()
    entries = {entry["step"]: entry for entry in map(json.loads, lines)}
    steps = sorted(entries)
    names = list(entries[steps[-1]]["training"])
    figure, axes = plt.subplots(2, (len(names) + 1) // 2, figsize=(16, 6), layout="constrained")
    for axis, name in zip(axes.flat, names, strict=False):
        for part in ("training", "validation"):
            axis.plot(steps, [entries[step][part][name] for step in steps], label=part)
        axis.set(title=name, xlabel="step")
        axis.legend()
    figure.savefig(out / "curves.png", dpi=80)
    plt.close(figure)


if __name__ == "__main__":
    train(tyro.cli(TrainingConfig))
