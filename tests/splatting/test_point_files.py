"""Coloured point clouds of a map, read back by trimesh."""

import jax.numpy as jnp
import numpy as np
import trimesh

from sfgs_jax.splatting import Gaussians, rgb_to_sh, save_points


def test_trimesh_reads_the_centres_and_colours_of_the_valid_gaussians(tmp_path):
    means = np.asarray([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]], np.float32)
    rgb = np.asarray([[0.2, 0.4, 2.0], [0.0, 0.0, 0.0], [1.0, 0.5, -1.0]], np.float32)
    sh = np.zeros((3, 4, 3), np.float32)
    sh[:, 0] = rgb_to_sh(rgb)
    gaussians = Gaussians(
        means=jnp.asarray(means),
        quaternions=jnp.asarray(np.tile(np.asarray([1, 0, 0, 0], np.float32), (3, 1))),
        log_scales=jnp.asarray(np.full((3, 3), -3, np.float32)),
        opacity_logits=jnp.asarray(np.zeros(3, np.float32)),
        sh=jnp.asarray(sh),
        valid=jnp.asarray(np.asarray([True, False, True])),
    )
    save_points(tmp_path / "points.ply", gaussians)
    cloud = trimesh.load(tmp_path / "points.ply")
    assert isinstance(cloud, trimesh.PointCloud)
    np.testing.assert_array_equal(cloud.vertices, means[[0, 2]])
    np.testing.assert_array_equal(np.asarray(cloud.colors)[:, :3], [[51, 102, 255], [255, 128, 0]])
