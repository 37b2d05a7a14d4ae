"""Images of the map for browsers that have no graphics card to draw it."""

from functools import cached_property
from typing import Literal, get_args

import jax
import numpy as np
import viser
from jaxtyping import Float

from sfgs_jax.geometry import Camera
from sfgs_jax.viewer._cameras import pose_of
from sfgs_jax.viewer._latest import Latest
from sfgs_jax.viewer._modes import Look
from sfgs_jax.viewer._painting import OPAQUE, Painter, picture_of

Drawer = Literal["browser", "library"]
"""Who draws the map: the browser that was sent the Gaussians, or the library that sends images."""

DRAWERS: tuple[Drawer, ...] = get_args(Drawer)

_MOVING_LINES, _RESTING_LINES = 360, 720
"""Lines of an image while the camera moves, and once it rests, however large the window is."""

MOVING_GAUSSIANS = 100_000
"""Gaussians that are drawn at most while the camera moves."""

_REST_S = 0.3
"""Time without a move after which the camera rests."""

_WIDTH_STEP = 32
"""Widths are multiples of it, so that windows of about the same shape share one compiled program."""

_FAR = 160.0
"""Depth of a pixel without a surface, metres; viser's images of depth end at 167."""


class ServerRendering:
    """Renders the map from each browser's camera, and sends the images as the background of its scene.

    While a camera moves, its images are small and show a sample of the Gaussians. Once it rests, a larger one
    shows all of them. Images hold the depth too, so that surfaces hide the path.

    Args:
        server: the viser server.
        painter: renders the map.
    """

    def __init__(self, server: viser.ViserServer, painter: Painter) -> None:
        self._server = server
        self._resting = painter
        self._shown: tuple[Look, Float[np.ndarray, "3"]] | None = None
        # A good image may take a second, and the first one has to compile: quick ones don't wait for it.
        self._quick, self._good = Latest("quick images"), Latest("good images")
        server.on_client_connect(self._connected)

    def show(self, look: Look, *, dark: bool) -> None:
        """Draw the map for all browsers, from now on.

        Args:
            look: what to draw.
            dark: whether black is behind the map, or white.
        """
        self._shown = look, np.zeros(3) if dark else np.ones(3)
        self._draw_for_all()

    def hide(self) -> None:
        """Draw nothing any more."""
        if self._shown is not None:
            self._shown = None
            self._draw_for_all()

    def close(self) -> None:
        """Drop what waits to be drawn."""
        self._quick.close()
        self._good.close()

    @cached_property
    def _moving(self) -> Painter:
        """Made when it is first needed: most pages never ask for it."""
        return self._resting.sampled(MOVING_GAUSSIANS)

    def _connected(self, client: viser.ClientHandle) -> None:
        client.camera.on_update(lambda _: self._moved(client))
        self._moved(client)

    def _draw_for_all(self) -> None:
        for client in self._server.get_clients().values():
            self._order(client)

    def _moved(self, client: viser.ClientHandle) -> None:
        if self._shown is not None:
            self._order(client)

    def _order(self, client: viser.ClientHandle) -> None:
        """Draw a quick image at once, and a good one when the camera rests."""
        name = str(client.client_id)
        self._quick.call(name, lambda: self._draw(client, self._moving, _MOVING_LINES))
        self._good.call(name, lambda: self._draw(client, self._resting, _RESTING_LINES), rest_s=_REST_S)

    def _draw(self, client: viser.ClientHandle, painter: Painter, lines: int) -> None:
        if self._shown is None:
            client.scene.set_background_image(None)
            return
        look, background = self._shown
        camera = window_camera(client.camera.fov, client.camera.aspect, lines)
        pose = pose_of(client.camera)
        output = jax.device_get(painter.render(pose, camera, look, background=background))
        image = picture_of(output, look, background=background)
        depth = np.where(output.alpha > OPAQUE, output.depth, np.float32(_FAR))
        if client.client_id in self._server.get_clients():
            client.scene.set_background_image(image, format="jpeg", jpeg_quality=90, depth=depth)


def window_camera(fov: float, aspect: float, lines: int) -> Camera:
    """Camera of an image that fills a browser's window; its pixels are not quite square.

    Args:
        fov: vertical field of view, radians.
        aspect: width of the window over its height.
        lines: height of the image, pixels.
    """
    width = max(1, round(lines * aspect / _WIDTH_STEP)) * _WIDTH_STEP
    focal = 0.5 * lines / np.tan(0.5 * fov)
    stretched = focal * width / (lines * aspect)
    return Camera(stretched, focal, (width - 1) / 2, (lines - 1) / 2, width=width, height=lines)
