"""Exposure of a map: its colours and the gains of its views go together."""

from dataclasses import replace

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from sfgs_jax.slam.state._gaussian_map import GaussianMap
from sfgs_jax.slam.state._map_state import MapState
from sfgs_jax.splatting import rgb_to_sh, sh_to_rgb


def brightened(gaussian_map: GaussianMap, factor: Float[np.ndarray, "3"]) -> GaussianMap:
    """The map with other colours, which are on the host.

    Args:
        gaussian_map: before.
        factor: (3,) on each channel.
    """
    sh = np.asarray(gaussian_map.gaussians.sh) * factor.astype(np.float32)
    # The coefficient of degree 0 is a colour less its middle.
    colour = sh_to_rgb(np.asarray(gaussian_map.gaussians.sh)[:, 0]) * factor
    sh[:, 0] = rgb_to_sh(colour)
    return eqx.tree_at(lambda m: m.gaussians.sh, gaussian_map, sh)


def in_the_exposure_of(mapping: MapState, places: range, brighter: Float[np.ndarray, "3"]) -> MapState:
    """The map whose views have the gains that go with its colours.

    Args:
        mapping: before.
        places: of the views whose gains went with other colours.
        brighter: (3,) factor from these colours to the map's.
    """
    views = list(mapping.views)
    for place in places:
        gain = np.asarray(views[place].gain)
        views[place] = replace(views[place], gain=(gain / brighter).astype(gain.dtype))
    return replace(mapping, views=tuple(views))


def in_the_mean_exposure(mapping: MapState) -> MapState:
    """The map with the colours of its mean view; those of seeds are the first view's.

    Map steps hold the mean of the views' gains at 1. A map that is darker or brighter would lose its first
    steps on that.

    Args:
        mapping: the map and at least one view.
    """
    mean = np.mean([view.gain for view in mapping.views], axis=0)
    if np.all(mean == 1):
        return mapping
    # A submap's number stands for its content.
    submaps = tuple(
        replace(submap, content=brightened(submap.content, mean), number=mapping.num_submaps + place)
        for place, submap in enumerate(mapping.submaps)
    )
    mapping = replace(
        mapping,
        map=jax.device_put(brightened(mapping.map, mean)),
        submaps=submaps,
        num_submaps=mapping.num_submaps + len(submaps),
    )
    return in_the_exposure_of(mapping, range(len(mapping.views)), mean)
