"""Refinement: map steps over all views once the recording has ended.

Views come in shuffled epochs. Where extra ones were kept after a view, they take its place in turns: else
such places would have more steps than the others. The views' poses take part: keypoints and depth leave
errors of a millimetre, which an image shows against the map. The learning rates decay, so that map and poses
come to rest.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Int

from sfgs_jax.geometry import Camera
from sfgs_jax.slam.config import MappingConfig
from sfgs_jax.slam.mapping._map_update import step_on_view
from sfgs_jax.slam.mapping._paging import with_surface_of
from sfgs_jax.slam.state._map_state import MapState

_TRIED = 8
"""Views that are tried. Gaussians that were set after a view was taken need room too."""
_ROUND = 256
"""Steps in which all places have their turn, where they are not in the map at once."""


def prepare_refinement(mapping: MapState, camera: Camera, config: MappingConfig, *, seed: int) -> MapState:
    """The map with the room that its first steps need, and with their programs compiled.

    Both are found by taking the steps, which are then forgotten. Compilation takes as long as many of them.

    Args:
        mapping: the map and at least one view.
        camera: of the views.
        config: settings.
        seed: of the order of the views.
    """
    for number in range(min(_TRIED, len(mapping.views))):
        stepped, _ = refine_once(mapping, camera, config, number=number, done=0.0, seed=seed)
        mapping = replace(mapping, pair_capacity=stepped.pair_capacity, view_capacity=stepped.view_capacity)
    return mapping


def refine_once(
    mapping: MapState, camera: Camera, config: MappingConfig, *, number: int, done: float, seed: int
) -> tuple[MapState, float]:
    """One step of the refinement.

    Args:
        mapping: the map and at least one view.
        camera: of the views.
        config: settings.
        number: of the step, from 0.
        done: share of the refinement that lies behind it.
        seed: of the order of the views.

    Returns:
        The map state, and the loss of the map before.
    """
    ordinary = np.flatnonzero([not view.extra for view in mapping.views])
    epoch, place = divmod(number, len(ordinary))
    # Each with the extra ones that follow it.
    sharing = np.diff(np.append(ordinary, len(mapping.views)))
    order = np.random.default_rng([seed, epoch]).permutation(ordinary + epoch % sharing)
    if mapping.num_submaps:
        order = _place_by_place(mapping, order)
        mapping = with_surface_of(mapping, mapping.views[order[place]], camera, config)
    decay = config.final_rate**done
    mapping, stepped = step_on_view(
        mapping, int(order[place]), camera, config, rate=config.first_rate * decay, view_rate=decay
    )
    return mapping, float(stepped.loss)


def _place_by_place(mapping: MapState, order: Int[np.ndarray, " v"]) -> Int[np.ndarray, " v"]:
    """The same order in rounds that go from place to place, so that few submaps change places at a time."""
    keyframes = np.asarray([view.keyframe for view in mapping.views])
    rounds = [order[start : start + _ROUND] for start in range(0, len(order), _ROUND)]
    return np.concatenate([numbers[np.argsort(keyframes[numbers], kind="stable")] for numbers in rounds])
