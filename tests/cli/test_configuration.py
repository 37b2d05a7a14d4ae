"""config.json holds everything needed to run again."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.cli import RunConfig, from_json, read_config, to_json
from sfgs_jax.datasets import ReaderOptions
from sfgs_jax.slam import LearningRates, MappingConfig, OptimisationConfig, SlamConfig


@pytest.fixture
def config() -> RunConfig:
    mapping = MappingConfig(
        view_interval=7, optimisation=OptimisationConfig(learning_rates=LearningRates(means=0.125))
    )
    reader = ReaderOptions(camera=Path("there/camera.json"), end=12, max_depth=3.0)
    slam = SlamConfig(mapping=mapping, seed=5)
    return RunConfig("recording", "folder", reader, slam, Path("earlier/sensors.json"))


def test_round_trip(config):
    assert from_json(to_json(config), "config.json") == config


def test_missing_settings_keep_their_defaults(config):
    data = json.loads(to_json(config))
    del data["slam"]["mapping"]["view_interval"]
    restored = from_json(json.dumps(data), "c")
    assert restored.slam.mapping == replace(config.slam.mapping, view_interval=MappingConfig().view_interval)


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (("slam", "mapping", "view_interval"), "two", "view_interval cannot be 'two'"),
        (("slam", "mapping", "view_interval"), True, "view_interval cannot be True"),
        (("slam", "speed"), 3, "a setting 'speed' that this version does not know"),
        (("reader",), 3, "must hold settings by name"),
        (
            ("reader", "stride"),
            0,
            "config.json: reader: The setting stride must be a whole number",
        ),
    ],
)
def test_wrong_settings_are_named(config, path, value, words):
    data = json.loads(to_json(config))
    place = data
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    with pytest.raises(InputError, match=words):
        from_json(json.dumps(data), "config.json")


def test_what_is_no_configuration_is_refused(tmp_path):
    with pytest.raises(InputError, match="is not JSON"):
        from_json("{", "config.json")
    with pytest.raises(InputError, match="lacks a setting"):
        from_json("{}", "config.json")
    with pytest.raises(InputError, match="Cannot read"):
        read_config(tmp_path / "config.json")
