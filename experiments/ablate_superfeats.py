"""What each loss of SuperFeats brings: short trainings that differ in nothing else, judged alike.

    python -m experiments.ablate_superfeats runs/ablation --steps 2000

Every variant sees the same batches from the same first weights. With `--description-from`, the description
branch of a run goes on, and what the detection branch's losses bring shows sooner. Judged are held-out views
(the share of points whose nearest descriptor is the right one), homographies of held-out photographs, and
relative poses on RedKitchen's frames 300 to 599, from mutual nearest neighbours without a floor, since
cosines of different losses differ in scale. Killed and started again, it goes on where it stopped.
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
from sfgs_jax.datasets import ReaderOptions
from sfgs_jax.geometry import InputError
from sfgs_jax.superfeats.network import Network
from sfgs_jax.superfeats.training import LossWeights

ALL = LossWeights()
# The hinge's weight brings it to the size that the dual softmax has in the sum.
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
    """A variant's network, and its share of held-out points whose nearest descriptor is the right one."""
    weights = VARIANTS[name]
    folder = out / name.replace(" ", "-")
    train(TrainingConfig(folder, steps=steps, description_from=description_from, weights=weights))
    params = superfeats.load_weights(folder / "weights.safetensors")
    if weights.reliability == 0:
        # An untrained head would weigh keypoints at random.
        params = by_heat_alone(params)
    figures = json.loads((folder / "log.jsonl").read_text().splitlines()[-1])["validation"]
    return params, figures["accuracy"]


def by_heat_alone(params: Network) -> Network:
    """The network with one reliability everywhere."""
    return eqx.tree_at(lambda network: network.rely, params, replace_fn=_zeros)


def _zeros(layer: eqx.Module) -> eqx.Module:
    return jax.tree.map(jnp.zeros_like, layer)


def extractors(networks: dict[str, Network], max_keypoints: int) -> list[Extractor]:
    """Without a floor for matches."""

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
    """Trains what isn't trained yet and prints the table.

    Args:
        out: folder of the runs.
        steps: of each training.
        seeds: how often RANSAC runs on each pair.
        variants: those to train and compare, by their names in `VARIANTS`.
        description_from: checkpoint.eqx of a run whose description branch all of them go on with.

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
