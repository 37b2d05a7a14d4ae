"""Trains SuperFeats with XFeat's labels and writes weights, a log of figures and a plot of them.

    python -m experiments.train_superfeats runs/superfeats --steps 20000

Started again with the same folder, it goes on after the last checkpoint, with the same batches as if it had
never stopped. Several JAX devices share each batch.
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
from sfgs_jax.datasets import read_photos
from sfgs_jax.geometry import InputError
from sfgs_jax.superfeats.layers import fold
from sfgs_jax.superfeats.network import Network, NetworkConfig, initialise_network
from sfgs_jax.superfeats.training import (
    Batch,
    LossWeights,
    TrainingState,
    evaluate,
    initial_state,
    train_step,
)
from sfgs_jax.superfeats.weights import save_weights

matplotlib.use("agg")
import matplotlib.pyplot as plt

# Of the recording that comes with the project's data, the second half is for judging, not for training.
_TRAINING_FRAMES = (0, 260)
_VALIDATION_FRAMES = (260, 300)
_VALIDATION_BATCHES = 8


@dataclass(frozen=True)
class TrainingConfig:
    """What a training run does."""

    out: tyro.conf.Positional[Path]
    """Folder of the run: checkpoint.eqx, weights.safetensors, log.jsonl, curves.png."""

    steps: int = 20_000
    """In all; the learning rate falls over them. Another number at a restart bends the rest of the fall."""

    pairs: int = 4
    """In a batch; even, and a multiple of the number of devices."""

    learning_rate: float = 2e-3
    """At first; it falls to a hundredth of it along a cosine."""

    warm_up: int = 200
    """Steps over which the learning rate rises to begin with."""

    seed: int = 0
    """Of the first weights and of the batches."""

    save_every: int = 250
    """Steps from one checkpoint, with its validation, to the next."""

    recording_share: float = 0.35
    """Share of pairs from the recording; 0 leaves it out."""

    data: Path = field(default_factory=lambda: default_weights().parents[1] / "data")
    """Folder with photos/ and 7scenes/redkitchen/."""

    photos: Path | None = None
    """Photographs elsewhere than in photos/."""

    layout: Literal["folder", "coco", "megadepth"] = "folder"
    """How they lie there."""

    description_from: Path | None = None
    """checkpoint.eqx of a run whose description branch, of the same widths, this one goes on with."""

    weights: LossWeights = field(default_factory=LossWeights)
    network: NetworkConfig = field(default_factory=NetworkConfig)


def train(config: TrainingConfig) -> None:
    """Trains until `config.steps`, from the last checkpoint if there is one."""
    if config.steps <= config.warm_up:
        raise InputError(f"{config.steps} steps leave none after the {config.warm_up} of the warm-up.")
    config.out.mkdir(parents=True, exist_ok=True)
    teacher = XFeat(threads=1)
    photos = sorted(read_photos(config.photos or config.data / "photos", layout=config.layout).paths)
    judged = held_out(photos)
    validation = _take(_scenes(config, judged, _VALIDATION_FRAMES), teacher, config)
    scenes = _scenes(config, sorted({*photos} - {*judged}), _TRAINING_FRAMES)

    optimiser = _optimiser(config.learning_rate, config.warm_up, config.steps)
    state = initial_state(_first_network(config), optimiser)
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
            _save(config, state, entry)


@cache
def _optimiser(learning_rate: float, warm_up: int, steps: int) -> optax.GradientTransformation:
    """One object for the same settings, so that a step of several runs is compiled once."""
    schedule = optax.warmup_cosine_decay_schedule(0.0, learning_rate, warm_up, steps, learning_rate / 100)
    return optax.chain(optax.clip_by_global_norm(1.0), optax.adam(schedule))


def _first_network(config: TrainingConfig) -> Network:
    network = initialise_network(jax.random.key(config.seed), config.network)
    if config.description_from is None:
        return network

    def description(network: Network) -> tuple:
        return network.levels, network.fusions, network.describe, network.rely

    # These come first in a checkpoint, so that it may hold another detection branch.
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
    return [next(stream) for _ in range(_VALIDATION_BATCHES)]


def _validate(state: TrainingState, validation: list[Batch], weights: LossWeights) -> dict[str, float]:
    network = fold(state.network)
    figures = [evaluate(network, batch, weights=weights) for batch in validation]
    return _mean([{name: float(value) for name, value in entry.items()} for entry in figures])


def _mean(figures: list[dict[str, float]]) -> dict[str, float]:
    return {name: round(float(np.mean([entry[name] for entry in figures])), 5) for name in figures[0]}


def _save(config: TrainingConfig, state: TrainingState, entry: dict) -> None:
    """Writes the checkpoint last, so that a stop in between repeats what was not saved."""
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
