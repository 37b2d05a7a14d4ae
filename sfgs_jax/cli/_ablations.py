"""Ablations: named settings that leave a part of the system out, or replace it."""

import dataclasses
from collections.abc import Callable
from typing import Literal, get_args

from sfgs_jax.slam import SlamConfig

Ablation = Literal["none", "no-gicp", "no-features", "orb", "no-graph", "no-loops", "no-window"]

ABLATIONS: tuple[Ablation, ...] = get_args(Ablation)
"""Names of the ablations; docs/command_line.md describes them."""


def ablated(config: SlamConfig, ablation: Ablation) -> SlamConfig:
    """The settings with one part left out or replaced; "none" leaves them as they are.

    Args:
        config: settings.
        ablation: one of `ABLATIONS`.

    Raises:
        InputError: nothing is left to track with.
    """
    return _CHANGES[ablation](config)


def _features(config: SlamConfig, kind: Literal["orb", "none"]) -> SlamConfig:
    features = dataclasses.replace(config.tracking.features, kind=kind)
    return dataclasses.replace(config, tracking=dataclasses.replace(config.tracking, features=features))


def _without_gicp(config: SlamConfig) -> SlamConfig:
    return dataclasses.replace(config, tracking=dataclasses.replace(config.tracking, use_surface=False))


def _graph(config: SlamConfig, **changes: int | bool) -> SlamConfig:
    return dataclasses.replace(config, graph=dataclasses.replace(config.graph, **changes))


_CHANGES: dict[Ablation, Callable[[SlamConfig], SlamConfig]] = {
    "none": lambda config: config,
    "no-gicp": _without_gicp,
    "no-features": lambda config: _features(config, "none"),
    "orb": lambda config: _features(config, "orb"),
    "no-graph": lambda config: _graph(config, enabled=False),
    "no-loops": lambda config: _graph(config, loops=False),
    "no-window": lambda config: _graph(config, window=0),
}
