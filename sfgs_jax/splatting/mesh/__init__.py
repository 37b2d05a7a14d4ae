"""Maps as triangle meshes: fusion of rendered depth images, marching cubes, and files."""

from sfgs_jax.splatting.mesh._mesh import Mesh as Mesh
from sfgs_jax.splatting.mesh._mesh import load_mesh as load_mesh
from sfgs_jax.splatting.mesh._mesh import save_mesh as save_mesh
from sfgs_jax.splatting.mesh._mesh import without_small_parts as without_small_parts
from sfgs_jax.splatting.mesh._tsdf_volume import TsdfVolume as TsdfVolume
from sfgs_jax.splatting.mesh._zero_surface import zero_surface as zero_surface
