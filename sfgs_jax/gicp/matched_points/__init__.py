"""Rigid motion between matched points."""

from sfgs_jax.gicp.matched_points._horn import absolute_orientation as absolute_orientation
from sfgs_jax.gicp.matched_points._rigid_motion import RigidResult as RigidResult
from sfgs_jax.gicp.matched_points._rigid_motion import rigid_from_matches as rigid_from_matches
