"""The page of a finished run in a browser: no errors, clicks, the replay's clock, what a slider sends."""

import json
import time

import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.geometry import Trajectory, format_tum, rotations_from_quaternions
from sfgs_jax.splatting import Gaussians, load_ply, rgb_to_sh, save_ply
from sfgs_jax.viewer import view_run
from tests.viewer.browser import OpenPage


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A wall of Gaussians, two metres in front of a path along x; a camera of 64 x 48 pixels."""
    folder = tmp_path_factory.mktemp("runs") / "wall"
    folder.mkdir()
    rng = np.random.default_rng(3)
    places = np.stack(np.meshgrid(np.linspace(-2, 2, 40), np.linspace(-1.5, 1.5, 30)), axis=-1).reshape(-1, 2)
    count = len(places)
    save_ply(
        folder / "map.ply",
        Gaussians(
            means=jnp.asarray(np.column_stack([places, np.full(count, 2.0)]), jnp.float32),
            quaternions=jnp.tile(jnp.asarray([1.0, 0, 0, 0]), (count, 1)),
            log_scales=jnp.tile(jnp.log(jnp.asarray([0.05, 0.05, 0.005])), (count, 1)),
            opacity_logits=jnp.full(count, 3.0),
            sh=rgb_to_sh(jnp.asarray(rng.uniform(0.3, 1, (count, 1, 3)), jnp.float32)),
            valid=jnp.ones(count, bool),
        ),
    )
    poses = np.tile(np.eye(4), (41, 1, 1))
    poses[:, 0, 3] = np.linspace(0, 0.8, 41)
    # Uneven time: half of the path in the first second, the rest in three.
    times = np.concatenate([np.linspace(0, 1, 21), 1 + 3 * np.linspace(0, 1, 21)[1:]])
    trajectory = Trajectory(times, poses)
    (folder / "trajectory.txt").write_text(format_tum(trajectory))
    (folder / "keyframes.txt").write_text(format_tum(trajectory[::20]))
    camera = {"fx": 64, "fy": 64, "cx": 31.5, "cy": 23.5, "width": 64, "height": 48}
    (folder / "metrics.json").write_text(json.dumps({"camera": camera}))
    scene = view_run(folder, port=0, block=False)
    yield scene
    scene.close()


@pytest.fixture(scope="module")
def page(browser, scene):
    page = OpenPage(browser, scene.server.get_port(), width=1200)
    yield page
    page.close()


@pytest.fixture(scope="module")
def received(page):
    """Sizes of what the page receives, from a second visit on."""
    sizes: list[int] = []
    page.page.on("websocket", lambda socket: socket.on("framereceived", lambda data: sizes.append(len(data))))
    page.reload()
    wait_until(page, lambda: sum(sizes) > 20_000)
    return sizes


def wait_until(page, condition, timeout_s: float = 60) -> None:
    # Playwright tells its events while it waits.
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, "it has not come about in time"
        page.page.wait_for_timeout(50)


def pixel_of(scene, point) -> tuple[float, float]:
    """Place of a point in the window of the page that looks."""
    (client,) = scene.server.get_clients().values()
    camera = client.camera
    rotation = rotations_from_quaternions(np.asarray(camera.wxyz)[None])[0]
    x, y, z = (point - camera.position) @ rotation
    focal = camera.image_height / 2 / np.tan(camera.fov / 2)
    return camera.image_width / 2 + focal * x / z, camera.image_height / 2 + focal * y / z


def test_a_slider_that_moves_sends_the_map_once(page, scene, received):
    page.page.wait_for_timeout(1000)
    before, size = sum(received), scene.splats.buffer.nbytes
    for value in np.linspace(1, 0.5, 11):
        scene.controls["Size"].value = float(value)
    wait_until(page, lambda: scene.splats.covariances[0, 0, 0] < 0.3 * 0.05**2)
    wait_until(page, lambda: sum(received) > before + 0.5 * size)
    page.page.wait_for_timeout(1000)
    assert sum(received) - before < 1.2 * size
    scene.controls["Size"].value = 1.0


def test_a_click_on_a_keyframe_takes_the_view_there(page, scene, received):
    place = scene.frusta[1].position + np.array([0, 0, 0.8 * scene.frusta[1].scale])
    wait_until(page, lambda: len(scene.server.get_clients()) == 1)
    (client,) = scene.server.get_clients().values()
    page.page.mouse.move(*pixel_of(scene, place))
    page.page.wait_for_timeout(300)
    page.page.mouse.click(*pixel_of(scene, place))
    wait_until(page, lambda: np.allclose(client.camera.position, scene.frusta[1].position, atol=1e-3))
    # The field of view comes in a message of its own.
    wait_until(page, lambda: np.isclose(client.camera.fov, 2 * np.arctan(24 / 64), rtol=1e-3))
    np.testing.assert_allclose(scene.replay.position, scene.frusta[1].position, atol=1e-6)
    # Nothing of the path is drawn over the view from there.
    wait_until(
        page, lambda: not scene.frusta[0].visible and not scene.path.visible and not scene.replay.visible
    )
    page.page.mouse.move(600, 250)
    page.page.mouse.wheel(0, 500)
    wait_until(page, lambda: scene.frusta[0].visible and scene.path.visible and scene.replay.visible)


def test_the_replay_goes_by_the_clock_of_the_recording(page, scene, received):
    page.page.get_by_role("tab", name="Replay").click()
    page.page.get_by_label("Play", exact=True).set_checked(True, force=True)
    wait_until(page, lambda: scene.replay.position[0] < 0.1)
    places, moments = [], []
    end = time.monotonic() + 60
    while not places or places[-1] < 0.7:
        assert time.monotonic() < end
        if (place := scene.replay.position[0]) not in places[-1:]:
            places.append(place)
            moments.append(time.monotonic())
        time.sleep(0.005)
    page.page.get_by_label("Play", exact=True).set_checked(False, force=True)
    seconds_per_frame = np.diff(moments) / (np.diff(places) / 0.02)
    fast = np.median(seconds_per_frame[np.array(places[1:]) < 0.41])
    slow = np.median(seconds_per_frame[np.array(places[1:]) > 0.41])
    # 50 ms a frame, then 150. A replay by the number of the frame would take as long for both. Medians, since
    # a machine with other work lets single frames wait.
    assert fast > 0.03
    assert slow / fast > 2


def test_the_browser_downloads_the_map(page, scene, received, tmp_path):
    page.page.get_by_role("tab", name="Save").click()
    with page.page.expect_download() as download:
        page.press("Map")
    assert download.value.suggested_filename == "map.ply"
    download.value.save_as(tmp_path / "map.ply")
    assert len(load_ply(tmp_path / "map.ply").means) == 1200


def test_the_console_has_no_errors(page):
    assert page.errors == []
