import socket

import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.geometry import Trajectory, format_tum, rotations_from_quaternions
from sfgs_jax.splatting import Gaussians, save_ply
from sfgs_jax.viewer import splats_of, view_run


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def _listening(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


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
    scene = view_run(run, port=_free_port(), block=False)
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
    np.testing.assert_allclose(scene.splats.covariances, 4 * splats.covariances, rtol=2e-3, atol=1e-6)
    shown = scene.splats.opacities[:, 0] > 0
    np.testing.assert_array_equal(shown, splats.opacities[:, 0] >= 0.5)


def test_the_replay_goes_where_the_trajectory_goes(scene, trajectory):
    scene.show_frame(4, follow=True)
    np.testing.assert_allclose(scene.replay.position, trajectory.positions[4], atol=1e-6)
    np.testing.assert_allclose(scene.replay.wxyz, [1, 0, 0, 0], atol=1e-6)


def test_the_server_listens_until_it_is_closed(run, capsys):
    scene = view_run(run, port=_free_port(), block=False)
    port = scene.server.get_port()
    assert f"http://127.0.0.1:{port}" in capsys.readouterr().out
    assert _listening(port)
    scene.close()
    assert not _listening(port)


def test_a_splat_file_alone_has_no_path(run):
    scene = view_run(run / "map.ply", port=_free_port(), block=False)
    try:
        assert scene.path is None
        assert scene.frusta == []
        assert len(scene.splats.centers) == 16
    finally:
        scene.close()


def test_nothing_to_show_is_an_input_error(tmp_path):
    with pytest.raises(InputError, match="There is no"):
        view_run(tmp_path / "none")
    with pytest.raises(InputError, match=r"holds no map\.ply"):
        view_run(tmp_path)
