"""Training runs that are killed, continued and started from others."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import jax
import numpy as np
import pytest

from experiments import train_superfeats
from experiments.train_superfeats import TrainingConfig, first_network, train
from sfgs_jax.arrays import InputError
from sfgs_jax.superfeats.network import Network, NetworkConfig, NormalisedConvolution

SMALL = NetworkConfig(channels=(8, 8, 8, 8), bottlenecks=(1, 1, 1, 1), context=8)


@pytest.fixture(autouse=True)
def _promotion_as_optax_needs_it():
    with jax.numpy_dtype_promotion("standard"):
        yield


@pytest.fixture(autouse=True, scope="module")
def _one_optimiser_of_the_same_settings():
    """So that all runs train by one program; each would compile its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(train_superfeats, "_optimiser", cache(train_superfeats._optimiser))
        yield


def short_run(out: Path, sfgs_data: Path) -> TrainingConfig:
    """A small network on photographs alone."""
    return TrainingConfig(
        out,
        steps=4,
        pairs=2,
        warm_up=1,
        save_every=2,
        validation_batches=1,
        recording_share=0.0,
        data=sfgs_data / "data",
        network=SMALL,
    )


def running_mean(network: Network, level: int) -> np.ndarray:
    """That of a level's first layer."""
    layer = network.levels[level].reduce
    assert isinstance(layer, NormalisedConvolution)
    return np.asarray(layer.mean)


@pytest.fixture(scope="module")
def whole(tmp_path_factory, sfgs_data):
    """Settings of a run that went on to its end."""
    config = short_run(tmp_path_factory.mktemp("runs") / "whole", sfgs_data)
    with jax.numpy_dtype_promotion("standard"):
        train(config)
    return config


def test_a_killed_run_goes_on_as_if_it_had_not_stopped(whole, tmp_path, monkeypatch):
    config = replace(whole, out=tmp_path / "killed")

    save = train_superfeats.save_checkpoint

    def save_and_stop(*arguments):
        save(*arguments)
        raise KeyboardInterrupt

    with monkeypatch.context() as killed:
        killed.setattr(train_superfeats, "save_checkpoint", save_and_stop)
        with pytest.raises(KeyboardInterrupt):
            train(config)
    train(config)

    expected, resumed = (run.out / "weights.safetensors" for run in (whole, config))
    assert expected.read_bytes() == resumed.read_bytes()
    first, second = (_figures(run.out) for run in (whole, config))
    assert [entry["step"] for entry in second] == [2, 4]
    for a, b in zip(first, second, strict=True):
        assert a["training"] == b["training"]
        assert np.isfinite(list(a["validation"].values())).all()
    assert (config.out / "curves.png").stat().st_size > 1000


def test_a_run_can_go_on_with_anothers_description_branch(whole, tmp_path):
    second = replace(whole, out=tmp_path / "second", seed=1, description_from=whole.out / "checkpoint.eqx")
    trained, begun, anew = (
        first_network(config)
        for config in (replace(second, seed=0), second, replace(second, description_from=None))
    )
    np.testing.assert_array_equal(begun.describe.weight, trained.describe.weight)
    np.testing.assert_array_equal(running_mean(begun, 2), running_mean(trained, 2))
    assert np.abs(running_mean(begun, 0)).max() > 0
    assert not np.array_equal(begun.describe.weight, anew.describe.weight)
    np.testing.assert_array_equal(begun.detect.weight, anew.detect.weight)


@pytest.mark.parametrize(
    "setting",
    [{"steps": 200}, {"pairs": 3}, {"save_every": 0}, {"learning_rate": 0.0}, {"recording_share": 1.5}],
)
def test_settings_out_of_range_are_refused(setting, tmp_path):
    with pytest.raises(InputError):
        TrainingConfig(tmp_path, data=tmp_path, **setting)


def _figures(run: Path) -> list[dict]:
    return [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]
