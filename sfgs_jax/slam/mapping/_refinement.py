"""Refinement: map steps over all views once the recording has ended.

Views come in shuffled epochs. Extra ones that were kept after a view take its place in turns, for else such
places would have more steps than the others. At its first turn a view fills what the map lacks: all that
ordinary views have measured is in it by then. The views' poses take part: keypoints and depth leave
errors of a millimetre, which an image shows against the map. The learning rates decay, so that map and poses
come to rest.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Int

from sfgs_jax.geometry import Camera
from sfgs_jax.slam.config import MappingConfig
from sfgs_jax.slam.mapping._paging import with_surface_of
from sfgs_jax.slam.mapping._view_insertion import fill
from sfgs_jax.slam.mapping._view_step import pose_of, step_on_view, view_room
from sfgs_jax.slam.state._gaussian_map import grow
from sfgs_jax.slam.state._map_state import MapState, View
from sfgs_jax.splatting import in_sight

_TRIED = 8
"""Views that are tried. Gaussians that were set after a view was taken need room too."""
_LOOKED_AT = 64
"""Views whose Gaussians in view are counted, spread over all."""
_ALMOST_FULL = 7 / 8
"""Share of the map's slots in use, beyond which it grows before the refinement."""
_ROUND = 256
"""Steps in which all places have their turn, where they are not in the map at once."""


def prepare_refinement(mapping: MapState, camera: Camera, config: MappingConfig, *, seed: int) -> MapState:
    """The map with the room that its first steps need, and with their programs compiled.

    A map that is almost full has no room for what is filled, so it grows. While the run lasted, what a view's
    surface hides was left out, so the Gaussians in view are counted anew. Room for pairs is found by taking
    the steps, which are then forgotten. Compilation takes as long as many of them.

    Args:
        mapping: the map and at least one view.
        camera: of the views.
        config: settings.
        seed: of the order of the views.
    """
    capacity = len(mapping.map.updates)
    largest = min(config.max_capacity, config.gaussians_in_memory)
    if np.mean(mapping.map.gaussians.valid) > _ALMOST_FULL and 2 * capacity <= largest:
        mapping = replace(mapping, map=grow(mapping.map))
    most = max(_count_in_view(mapping, view, camera) for view in _spread(mapping.views))
    mapping = replace(mapping, view_capacity=max(mapping.view_capacity, view_room(most)))
    for number in range(min(_TRIED, len(mapping.views))):
        stepped, _ = refine_once(mapping, camera, config, number=number, done=0.0, seed=seed)
        mapping = replace(mapping, pair_capacity=stepped.pair_capacity, view_capacity=stepped.view_capacity)
    return mapping


def _spread(views: tuple[View, ...]) -> tuple[View, ...]:
    """A few views, evenly among all."""
    return views[:: max(1, len(views) // _LOOKED_AT)]


def _count_in_view(mapping: MapState, view: View, camera: Camera) -> int:
    """Gaussians that a view's camera sees."""
    return int(np.sum(in_sight(mapping.map.gaussians, camera, pose_of(view, mapping))))


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
    view, decay = int(order[place]), config.final_rate**done
    mapping, stepped = step_on_view(
        mapping, view, camera, config, rate=config.first_rate * decay, view_rate=decay
    )
    if _is_first(view, epoch, ordinary):
        mapping = fill(mapping, view, stepped, camera, config)
    return mapping, float(stepped.loss)


def _is_first(view: int, epoch: int, ordinary: Int[np.ndarray, " o"]) -> bool:
    """True in the epoch in which a view takes its first turn: that of its place after its ordinary view."""
    return bool(epoch == view - ordinary[np.searchsorted(ordinary, view, side="right") - 1])


def _place_by_place(mapping: MapState, order: Int[np.ndarray, " v"]) -> Int[np.ndarray, " v"]:
    """The same order in rounds that go from place to place, so that few submaps change places at a time."""
    keyframes = np.asarray([view.keyframe for view in mapping.views])
    rounds = [order[start : start + _ROUND] for start in range(0, len(order), _ROUND)]
    return np.concatenate([numbers[np.argsort(keyframes[numbers], kind="stable")] for numbers in rounds])
