"""Initial values: spanning tree and chordal relaxation."""

from sfgs_jax.factor_graph.start._chordal_relaxation import chordal_start as chordal_start
from sfgs_jax.factor_graph.start._nearest_rotations import nearest_rotations as nearest_rotations
from sfgs_jax.factor_graph.start._spanning_tree import spanning_tree_start as spanning_tree_start
