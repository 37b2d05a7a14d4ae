"""Ablation of SuperFeats' losses: short trainings that differ in nothing else.

    python -m experiments.ablate_superfeats runs/ablation --steps 2000

Every variant sees the same batches from the same first weights. With `--description-from` all continue the
description branch of one run, which shows the effect of the detection branch's losses sooner. Killed and
started again, the ablation continues.

The tables show, for each variant:

- the share of held-out points whose nearest descriptor is the right one;
- homographies of held-out photographs;
- relative poses on RedKitchen's frames 300 to 599.

Matches are mutual nearest neighbours without a floor, because cosines of different losses differ in scale.
"""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import tyro

from experiments.extractors import Extractor
from experiments.feature_matching import PLANE_KEYPOINTS, REDKITCHEN, of_recording, unseen_photos
from experiments.matching_tables import (
    PLANE_COLUMNS,
    POSE_COLUMNS,
    TOTAL,
    plane_table,
    pose_table,
    print_table,
)
from experiments.train_superfeats import TrainingConfig, train
from experiments.warped_photos import warped_photos
from sfgs_jax import superfeats
from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import ReaderOptions
from sfgs_jax.superfeats.network import Network
from sfgs_jax.superfeats.training import LossWeights

ALL = LossWeights()
# With this weight the hinge is as large in the sum as the dual softmax.
VARIANTS = {
    "as shipped": ALL,
    "hinge for dual softmax": replace(ALL, dual_softmax=0.0, hinge=4.0),
    "without imitation": replace(ALL, imitation=0.0),
    "without reliability": replace(ALL, reliability=0.0),
    "contrast for reprojection": replace(ALL, reprojection=0.0, contrast=0.2),
    "without reprojection": replace(ALL, reprojection=0.0),
}
KEYPOINTS = 2048
PHOTOS = 40


def trained(name: str, out: Path, steps: int, description_from: Path | None) -> tuple[Network, float]:
    """Train a variant.

    Returns:
        Its network, and the share of held-out points whose nearest descriptor is the right one.
    """
    weights = VARIANTS[name]
    folder = out / name.replace(" ", "-")
    train(TrainingConfig(folder, steps=steps, description_from=description_from, weights=weights))
    params = superfeats.load_weights(folder / "weights.safetensors")
    if weights.reliability == 0:
        # An untrained head would weight keypoints at random.
        params = by_heat_alone(params)
    figures = json.loads((folder / "log.jsonl").read_text().splitlines()[-1])["validation"]
    return params, figures["accuracy"]


def by_heat_alone(params: Network) -> Network:
    """The network with the same reliability everywhere."""
    return eqx.tree_at(lambda network: network.rely, params, replace_fn=_zeros)


def _zeros(layer: eqx.Module) -> eqx.Module:
    return jax.tree.map(jnp.zeros_like, layer)


def extractors(networks: dict[str, Network], max_keypoints: int) -> list[Extractor]:
    """Extractors of the networks, without a floor for matches."""

    def extract(params: Network, image: np.ndarray) -> superfeats.Features:
        return superfeats.extract(params, image, max_keypoints=max_keypoints)

    return [Extractor(name, partial(extract, params), 0.0) for name, params in networks.items()]


def main(
    out: tyro.conf.Positional[Path],
    steps: int = 2000,
    seeds: int = 5,
    variants: tuple[str, ...] = tuple(VARIANTS),
    description_from: Path | None = None,
) -> None:
    """Train the variants that are not trained yet and print the tables.

    Args:
        out: folder of the runs.
        steps: steps of each training.
        seeds: number of RANSAC's runs on each pair.
        variants: names of the variants to train and compare.
        description_from: checkpoint.eqx of a run whose description branch all variants start from.

    Raises:
        InputError: there is no such variant.
    """
    if unknown := {*variants} - {*VARIANTS}:
        raise InputError(f"No variant {sorted(unknown)}; there are {list(VARIANTS)}.")
    networks, accuracies = {}, {}
    for name in variants:
        networks[name], accuracies[name] = trained(name, out, steps, description_from)
        if VARIANTS[name] == ALL:
            alone = f"{name}, keypoints by heat alone"
            networks[alone], accuracies[alone] = by_heat_alone(networks[name]), accuracies[name]
    samples = of_recording(REDKITCHEN, ReaderOptions(start=300, end=600))
    rows = [
        (*row, f"{accuracies[row[0]]:.3f}")
        for row in pose_table(samples, extractors(networks, KEYPOINTS), seeds=seeds)
        if row[2] == TOTAL
    ]
    print_table(f"{steps} steps of each variant", (*POSE_COLUMNS, "nearest is right"), rows)
    pairs = warped_photos(unseen_photos(), count=PHOTOS, seed=0)
    planes = plane_table(pairs, extractors(networks, PLANE_KEYPOINTS))
    print_table(f"Homographies, {PHOTOS} photographs", PLANE_COLUMNS, planes)


if __name__ == "__main__":
    tyro.cli(main)
