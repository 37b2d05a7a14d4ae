"""Files of maps: PLY, point clouds and the formats of viewers."""

from sfgs_jax.splatting.files._background_file import BACKGROUND_FILE as BACKGROUND_FILE
from sfgs_jax.splatting.files._background_file import format_background as format_background
from sfgs_jax.splatting.files._background_file import read_background as read_background
from sfgs_jax.splatting.files._contents import Contents as Contents
from sfgs_jax.splatting.files._contents import contents_of as contents_of
from sfgs_jax.splatting.files._gltf import save_gltf as save_gltf
from sfgs_jax.splatting.files._gltf_reader import load_gltf as load_gltf
from sfgs_jax.splatting.files._map_file import load_map as load_map
from sfgs_jax.splatting.files._map_file import map_file as map_file
from sfgs_jax.splatting.files._ply import load_ply as load_ply
from sfgs_jax.splatting.files._ply import save_ply as save_ply
from sfgs_jax.splatting.files._points import coloured_points as coloured_points
from sfgs_jax.splatting.files._points import load_coloured_points as load_coloured_points
from sfgs_jax.splatting.files._points import save_points as save_points
from sfgs_jax.splatting.files._splat import load_splat as load_splat
from sfgs_jax.splatting.files._splat import save_splat as save_splat
from sfgs_jax.splatting.files._spz import load_spz as load_spz
from sfgs_jax.splatting.files._spz import save_spz as save_spz
