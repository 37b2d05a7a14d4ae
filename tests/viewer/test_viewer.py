import dataclasses
import socket
import time

import jax.numpy as jnp
import numpy as np
import pytest
import viser

from sfgs_jax.arrays import InputError
from sfgs_jax.geometry import Trajectory, format_tum, rotations_from_quaternions
from sfgs_jax.splatting import Gaussians, load_ply, load_spz, save_gltf, save_ply, save_splat, save_spz
from sfgs_jax.viewer import MapScene, splats_of, view_run


def _listening(port: int, host: str = "127.0.0.1") -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((host, port)) == 0


@pytest.fixture
def gaussians(rng) -> Gaussians:
    n = 20
    return Gaussians(
        means=jnp.asarray(rng.normal(size=(n, 3)), jnp.float32),
        quaternions=jnp.asarray(rng.normal(size=(n, 4)), jnp.float32),
        log_scales=jnp.asarray(rng.uniform(-4, -2, (n, 3)), jnp.float32),
        opacity_logits=jnp.asarray(np.linspace(-2, 2, n), jnp.float32),
        sh=jnp.zeros((n, 1, 3)).at[:, 0, 0].set(0.2820948),
        valid=jnp.arange(n) < 16,
    )


@pytest.fixture
def trajectory() -> Trajectory:
    poses = np.tile(np.eye(4), (6, 1, 1))
    poses[:, 0, 3] = np.linspace(0, 1, 6)
    return Trajectory(np.arange(6.0), poses)


@pytest.fixture
def run(gaussians, trajectory, tmp_path):
    save_ply(tmp_path / "map.ply", gaussians)
    (tmp_path / "trajectory.txt").write_text(format_tum(trajectory))
    (tmp_path / "keyframes.txt").write_text(format_tum(trajectory[::3]))
    return tmp_path


@pytest.fixture
def scene(run):
    scene = view_run(run, port=0, block=False)
    yield scene
    scene.close()


def test_covariances_colours_and_opacities(gaussians):
    splats = splats_of(gaussians)
    assert splats.centres.shape == (16, 3)
    rotations = rotations_from_quaternions(np.asarray(gaussians.quaternions)[:16])
    for i in range(16):
        squares = np.diag(np.exp(2 * np.asarray(gaussians.log_scales[i], np.float64)))
        expected = rotations[i] @ squares @ rotations[i].T
        np.testing.assert_allclose(splats.covariances[i], expected, rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(splats.opacities[0, 0], 1 / (1 + np.exp(2)), rtol=1e-5)
    np.testing.assert_allclose(splats.rgb, [[0.5 + 0.2820948**2, 0.5, 0.5]] * 16, rtol=1e-5)


def test_it_listens_on_this_machine_alone(scene):
    port = scene.server.get_port()
    assert _listening(port)
    # Another address of the same machine, which a server that listens on all of them answers.
    assert not _listening(port, "127.0.0.2")


def test_the_scene_holds_the_map_and_the_path(scene, gaussians, trajectory):
    np.testing.assert_allclose(scene.splats.centers, gaussians.means[:16], rtol=1e-6)
    np.testing.assert_allclose(
        scene.splats.covariances, splats_of(gaussians).covariances, rtol=2e-3, atol=1e-7
    )
    assert scene.path.points.shape == (5, 2, 3)
    np.testing.assert_allclose(scene.path.points[:, 1], trajectory.positions[1:], atol=1e-6)
    assert [frustum.name for frustum in scene.frusta] == [
        "/trajectory/keyframes/0",
        "/trajectory/keyframes/1",
    ]
    np.testing.assert_allclose(scene.frusta[1].position, trajectory.positions[3], atol=1e-6)


def test_size_and_opacity_are_applied_to_the_original_map(scene, gaussians):
    splats = splats_of(gaussians)
    for _ in range(2):
        scene.show_map(size=2.0, least_opacity=0.5)
    opaque = splats.opacities[:, 0] >= 0.5
    np.testing.assert_allclose(scene.splats.covariances, 4 * splats.covariances[opaque], rtol=2e-3, atol=1e-6)
    np.testing.assert_allclose(scene.splats.centers, splats.centres[opaque], rtol=1e-6)


def test_the_controls_crop_the_map(scene, gaussians):
    scene.controls["Right"].value = (0.0, scene.controls["Right"].max)
    scene.controls["Crop"].value = True
    edges = scene.server.scene.get_handle_by_name("/crop")
    assert edges.visible
    assert edges.points.shape == (12, 2, 3)
    inside = np.asarray(gaussians.means)[:16, 0] >= 0
    end = time.monotonic() + 30
    while len(scene.splats.centers) != inside.sum() and time.monotonic() < end:
        time.sleep(0.05)
    np.testing.assert_allclose(scene.splats.centers, np.asarray(gaussians.means)[:16][inside], rtol=1e-6)
    scene.controls["Crop"].value = False
    assert not edges.visible


@pytest.mark.parametrize("mode", ["splats", "points", "depth", "normals", "uncertainty"])
def test_an_empty_map_is_shown_as_nothing(gaussians, mode):
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    nothing = Trajectory(np.zeros(0), np.zeros((0, 4, 4)))
    empty = splats_of(dataclasses.replace(gaussians, valid=jnp.zeros(20, bool)))
    scene = MapScene(server, empty, nothing, nothing)
    try:
        scene.show_map(mode=mode)
        assert not scene.splats.visible
    finally:
        scene.close()


def test_the_replay_goes_where_the_trajectory_goes(scene, trajectory):
    scene.show_frame(4, follow=True)
    np.testing.assert_allclose(scene.replay.position, trajectory.positions[4], atol=1e-6)
    np.testing.assert_allclose(scene.replay.wxyz, [1, 0, 0, 0], atol=1e-6)


def test_the_server_listens_until_it_is_closed(run, capsys):
    scene = view_run(run, port=0, block=False)
    port = scene.server.get_port()
    said = capsys.readouterr().out
    assert f"{scene.url} (this machine alone can open it" in said
    assert f'<iframe src="http://127.0.0.1:{port}"' in scene._repr_html_()
    assert _listening(port)
    scene.close()
    assert not _listening(port)


@pytest.mark.parametrize(
    ("name", "save"),
    [("a.ply", save_ply), ("a.splat", save_splat), ("a.spz", save_spz), ("a.glb", save_gltf)],
)
def test_a_file_of_gaussians_alone_has_no_path(gaussians, tmp_path, name, save):
    save(tmp_path / name, gaussians)
    scene = view_run(tmp_path / name, port=0, block=False)
    try:
        assert scene.path is None
        assert scene.frusta == []
        assert len(scene.splats.centers) == 16
        with pytest.raises(InputError, match="pose"):
            scene.save_still(tmp_path / "a.png", width=64, height=48)
        with pytest.raises(InputError, match="no video"):
            scene.save_video(tmp_path / "a.mp4", width=64, height=48)
    finally:
        scene.close()


def test_of_a_large_map_a_sample_covers_the_area(run, gaussians):
    scene = view_run(run, port=0, block=False, max_gaussians=4)
    try:
        chosen = [
            int(np.argmin(np.linalg.norm(np.asarray(gaussians.means) - centre, axis=1)))
            for centre in scene.splats.centers
        ]
        assert len(set(chosen)) == 4
        expected = 1.3 * 4 * splats_of(gaussians).covariances[chosen]
        np.testing.assert_allclose(scene.splats.covariances, expected, rtol=2e-3, atol=1e-6)
    finally:
        scene.close()


def test_modes_change_colours_and_leave_the_gaussians(scene, gaussians):
    splats = splats_of(gaussians)
    scene.show_map(mode="normals")
    smallest = np.argmin(np.asarray(gaussians.log_scales)[:16], axis=1)
    rotations = rotations_from_quaternions(np.asarray(gaussians.quaternions)[:16])
    normals = np.abs(rotations[np.arange(16), :, smallest])
    # Without planes the axes are the first camera's: right, ahead and up.
    np.testing.assert_allclose(scene.splats.rgbs / 255, normals[:, [0, 2, 1]], atol=0.01)
    np.testing.assert_allclose(scene.splats.centers, splats.centres, rtol=1e-6)
    scene.show_map(mode="depth")
    assert (scene.splats.rgbs == 255).all()
    scene.show_map(mode="points")
    assert not scene.splats.visible
    points = scene.server.scene.get_handle_by_name("/points")
    np.testing.assert_allclose(points.points, splats.centres)
    scene.show_map()
    assert scene.splats.visible
    assert not points.visible
    np.testing.assert_allclose(scene.splats.rgbs / 255, splats.rgb, atol=0.01)


def test_a_crop_box_cuts_the_map_and_its_files(scene, gaussians, tmp_path):
    box = scene.box((-10.0, -10.0, -10.0), (10.0, 10.0, 0.3))
    scene.show_map(crop=box)
    # y points down, so that up to 0.3 m is y from -0.3 m on.
    inside = np.asarray(gaussians.means)[:16, 1] >= -0.3
    assert 0 < inside.sum() < 16
    np.testing.assert_allclose(scene.splats.centers, np.asarray(gaussians.means)[:16][inside], rtol=1e-6)
    for name, load in (("m.ply", load_ply), ("m.spz", load_spz)):
        scene.save_map(tmp_path / name)
        assert len(load(tmp_path / name).means) == inside.sum()
    scene.save_map(tmp_path / "m.glb")
    assert (tmp_path / "m.glb").read_bytes()[:4] == b"glTF"
    with pytest.raises(InputError, match="names no format"):
        scene.save_map(tmp_path / "m.obj")
    scene.show_map(crop=scene.box((50.0, 50.0, 50.0), (60.0, 60.0, 60.0)))
    assert not scene.splats.visible
    with pytest.raises(InputError, match="nothing to save"):
        scene.save_map(tmp_path / "m.ply")


def test_nothing_to_show_is_an_input_error(tmp_path):
    with pytest.raises(InputError, match="There is no"):
        view_run(tmp_path / "none")
    with pytest.raises(InputError, match=r"holds no map\.ply"):
        view_run(tmp_path)
    (tmp_path / "map.glb").write_bytes(b"glTF")
    with pytest.raises(InputError, match="no binary glTF"):
        view_run(tmp_path / "map.glb")
    (tmp_path / "map.obj").write_bytes(b"v 0 0 0")
    with pytest.raises(InputError, match=r"\.ply, \.splat, \.spz"):
        view_run(tmp_path / "map.obj")
