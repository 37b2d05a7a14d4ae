"""Meshes and point clouds in the browser, as `sfgs-jax export` writes them."""

import time

import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.cli import main
from sfgs_jax.splatting import Gaussians, load_coloured_points, save_gltf, save_ply, save_points
from sfgs_jax.splatting.mesh import Mesh, load_mesh, save_mesh
from sfgs_jax.viewer import view_model
from tests.viewer.browser import OpenPage


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    """A green square of two metres, three metres ahead, towards the camera, and a red corner."""
    corners = np.array([[-1.0, -1, 3], [1, -1, 3], [1, 1, 3], [-1, 1, 3]])
    rgb = np.array([[0.0, 0.6, 0]] * 3 + [[0.8, 0.1, 0]])
    return Mesh(corners, np.array([[0, 2, 1], [0, 3, 2]]), rgb)


@pytest.fixture(scope="module")
def gaussians() -> Gaussians:
    return Gaussians(
        means=jnp.asarray(np.random.default_rng(0).normal(size=(9, 3)), jnp.float32),
        quaternions=jnp.tile(jnp.asarray([1.0, 0, 0, 0]), (9, 1)),
        log_scales=jnp.full((9, 3), -3.0),
        opacity_logits=jnp.zeros(9),
        sh=jnp.full((9, 1, 3), 0.5),
        valid=jnp.ones(9, bool),
    )


@pytest.mark.parametrize("name", ["square.ply", "square.glb"])
def test_a_mesh_is_read_as_it_was_written(mesh, tmp_path, name):
    save_mesh(tmp_path / name, mesh)
    found = load_mesh(tmp_path / name)
    np.testing.assert_allclose(found.vertices, mesh.vertices, atol=1e-6)
    np.testing.assert_array_equal(found.triangles, mesh.triangles)
    # Dark colours of linear light have few of the 8 bits.
    np.testing.assert_allclose(found.rgb, mesh.rgb, atol=0.02)


def test_points_are_read_as_they_were_written(gaussians, tmp_path):
    save_points(tmp_path / "points.ply", gaussians)
    places, rgb = load_coloured_points(tmp_path / "points.ply")
    np.testing.assert_allclose(places, gaussians.means)
    assert rgb.dtype == np.uint8
    assert np.ptp(rgb) == 0


def test_points_and_meshes_have_a_page(mesh, gaussians, tmp_path, capsys):
    save_points(tmp_path / "points.ply", gaussians)
    save_mesh(tmp_path / "square.ply", mesh)
    for name, what in (("points.ply", 9), ("square.ply", None)):
        scene = view_model(tmp_path / name, port=0, block=False)
        try:
            assert f"{scene.url} (this machine alone can open it" in capsys.readouterr().out
            assert scene.url in scene._repr_html_()
            assert what is None or len(scene.node.points) == what  # type: ignore[attr-defined]
        finally:
            scene.close()


def test_the_browser_shows_a_mesh(browser, mesh, tmp_path):
    save_mesh(tmp_path / "square.glb", mesh)
    scene = view_model(tmp_path / "square.glb", port=0, block=False)
    page = OpenPage(browser, scene.server.get_port(), width=400)
    try:
        end = time.monotonic() + 60
        while not _green_in_the_middle(page.canvas()):
            assert time.monotonic() < end, "the mesh has not come in time"
            page.page.wait_for_timeout(100)
        assert page.errors == []
    finally:
        page.close()
        scene.close()


def _green_in_the_middle(image: np.ndarray) -> bool:
    red, green, blue = image[image.shape[0] // 2, image.shape[1] // 2].tolist()
    return green > 1.5 * max(red, blue)


@pytest.mark.parametrize("name", ["none.ply", "cut.glb", "map.glb", "map.ply", "empty.ply"])
def test_what_is_no_model_gets_one_sentence(gaussians, tmp_path, name):
    (tmp_path / "cut.glb").write_bytes(b"glTF")
    save_gltf(tmp_path / "map.glb", gaussians)
    save_ply(tmp_path / "map.ply", gaussians)
    header = "ply\nformat binary_little_endian 1.0\nelement vertex 0\n" + "".join(
        f"property float {a}\n" for a in "xyz"
    )
    (tmp_path / "empty.ply").write_text(header + "end_header\n")
    with pytest.raises(InputError, match=name.replace(".", r"\.")):
        view_model(tmp_path / name, port=0, block=False)


def test_a_mesh_is_no_map(mesh, tmp_path, capsys):
    save_mesh(tmp_path / "square.glb", mesh)
    assert main(["render", str(tmp_path / "square.glb"), "--out", str(tmp_path / "images")]) == 2
    assert "holds a mesh, no Gaussians" in capsys.readouterr().err
