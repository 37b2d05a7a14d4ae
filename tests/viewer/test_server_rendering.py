"""A map that the library draws for a browser: its image, what hides what, what is sent, and the way back."""

import time

import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.geometry import Camera, rotations_from_quaternions, se3
from sfgs_jax.splatting import Gaussians, Renderer, rgb_to_sh, save_ply
from sfgs_jax.viewer import view_run
from tests.viewer.browser import OpenPage, similarity

_WINDOW = 320, 480


def _patchwork() -> Gaussians:
    """A wall of coarse coloured patches, two metres from the origin along z."""
    x, y = np.meshgrid(np.linspace(-2, 2, 60), np.linspace(-1.5, 1.5, 45))
    count = x.size
    colours = np.stack([np.sin(3 * x) > 0, np.sin(4 * y) > 0, np.full(x.shape, 0.5)], axis=-1)
    return Gaussians(
        means=jnp.asarray(np.column_stack([x.ravel(), y.ravel(), np.full(count, 2.0)]), jnp.float32),
        quaternions=jnp.tile(jnp.asarray([1.0, 0, 0, 0]), (count, 1)),
        log_scales=jnp.tile(jnp.log(jnp.asarray([0.04, 0.04, 0.005])), (count, 1)),
        opacity_logits=jnp.full(count, 5.0),
        sh=rgb_to_sh(jnp.asarray(0.2 + 0.6 * colours.reshape(-1, 1, 3), jnp.float32)),
        valid=jnp.ones(count, bool),
    )


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    path = tmp_path_factory.mktemp("maps") / "wall.ply"
    save_ply(path, _patchwork())
    scene = view_run(path, port=0, block=False, drawn_by="library")
    start = scene.server.initial_camera
    start.position, start.look_at, start.up = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)
    for name, z, colour in (("front", 1.5, (255, 0, 255)), ("behind", 2.5, (0, 255, 255))):
        x = -0.4 if name == "front" else 0.4
        scene.server.scene.add_icosphere(f"/{name}", 0.1, color=colour, position=(x, 0.0, z))
    yield scene
    scene.close()


@pytest.fixture(scope="module")
def page(browser, scene):
    page = OpenPage(browser, scene.server.get_port(), width=_WINDOW[1], height=_WINDOW[0])
    # The panel lies over a quarter of the image.
    page.page.add_style_tag(content="[class*='Paper-root'] { visibility: hidden }")
    yield page
    page.close()


def _wait_until(page, condition, timeout_s: float = 90) -> None:
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, "it has not come about in time"
        page.page.wait_for_timeout(100)


_render = Renderer(headroom=2.0)


def _expected(scene):
    """The library's own image of what the browser's camera sees."""
    (client,) = scene.server.get_clients().values()
    pose, seen = np.eye(4), client.camera
    pose[:3, :3] = rotations_from_quaternions(np.asarray(seen.wxyz)[None])[0]
    pose[:3, 3] = seen.position
    # The page draws fewer pixels than the window has if that takes too long.
    height, width = _WINDOW
    focal = 0.5 * height / np.tan(0.5 * seen.fov)
    camera = Camera(focal, focal, (width - 1) / 2, (height - 1) / 2, width=width, height=height)
    return np.asarray(_render(_patchwork(), camera, se3.from_matrix(pose)).rgb)


def _share(image, colour) -> float:
    """Share of the pixels that have nearly a colour."""
    return float(np.mean(np.max(np.abs(image - np.asarray(colour)), axis=-1) < 0.25))


def test_the_page_shows_the_library_s_image(page, scene):
    _wait_until(page, lambda: similarity(page.canvas(), _expected(scene)) > 0.9)


def test_surfaces_hide_what_is_behind_them(page, scene):
    canvas = page.canvas()
    assert _share(canvas, (0.85, 0, 0.85)) > 0.001
    assert _share(canvas, (0, 0.85, 0.85)) == 0


def test_the_browser_has_no_gaussians_to_draw(scene):
    assert len(scene.splats.buffer) == 1
    assert not scene.splats.visible


def test_the_image_follows_the_camera(page, scene):
    before = _expected(scene)
    page.page.mouse.move(100, 160)
    page.page.mouse.wheel(0, -500)
    page.page.mouse.down()
    page.page.mouse.move(160, 190, steps=5)
    page.page.mouse.up()
    _wait_until(page, lambda: np.abs(_expected(scene) - before).mean() > 0.05)
    _wait_until(page, lambda: similarity(page.canvas(), _expected(scene)) > 0.9)


def test_a_look_is_drawn_too(page, scene):
    scene.controls["Show"].value = "Normals"
    # The wall's normals point along the view: they are green, the colour of ahead.
    _wait_until(page, lambda: _share(page.canvas(), (0, 1, 0)) > 0.2)
    scene.controls["Show"].value = "Splats"


def test_the_browser_draws_again(page, scene):
    scene.controls["Drawn by"].value = "browser"
    _wait_until(page, lambda: scene.splats.visible and len(scene.splats.buffer) == 2700)
    # Behind the map is viser's dark grey, and not black.
    _wait_until(page, lambda: np.abs(page.canvas() - _expected(scene)).mean() < 0.08)
    assert page.errors == []
