"""Gaussians that are not finite are counted."""

import equinox as eqx
import jax.numpy as jnp

from experiments.long_refinement import not_finite
from sfgs_jax.slam.state import empty_map


def test_gaussians_that_are_not_finite_are_counted():
    gaussians = empty_map(8).gaussians
    means = gaussians.means.at[1, 0].set(jnp.nan).at[6, 0].set(jnp.nan)
    sh = gaussians.sh.at[1, 0, 0].set(jnp.inf).at[3, 0, 2].set(jnp.inf)
    # Slots that are empty may hold anything, such as the sixth.
    some = eqx.tree_at(lambda g: (g.valid, g.means, g.sh), gaussians, (jnp.arange(8) < 5, means, sh))
    assert not_finite(some) == 2
