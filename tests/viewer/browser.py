"""A headless Chromium with WebGL in software, for tests of the viewer's pages."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from playwright.sync_api import Browser, ConsoleMessage, Page, sync_playwright

from sfgs_jax.splatting import ssim

PROGRAMS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
"""Names that distributions give the program."""

OPTIONS = [
    "--headless=new",
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
]

# viser 1.1 gives the quad of a splat two coordinates, and three.js looks for a third. Nothing else is wrong.
TOLERATED = ("THREE.BufferGeometry.computeBoundingSphere(): Computed radius is NaN",)
"""Beginnings of errors on the console that are no fault of the page."""


def find_chromium() -> str | None:
    """Path of the browser, if one is installed."""
    return next((path for name in PROGRAMS if (path := shutil.which(name))), None)


@contextmanager
def headless(program: str) -> Iterator[Browser]:
    """A running browser.

    Args:
        program: its path.
    """
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=OPTIONS)
        try:
            yield browser
        finally:
            browser.close()


class OpenPage:
    """A page that has connected to a viewer.

    Args:
        browser: from `headless`.
        port: of the viewer on this machine.
        width: of the window, pixels.
        height: of the window, pixels.

    Attributes:
        page: Playwright's page.
        errors: what the page wrote to the console as an error, and exceptions that nothing caught.
    """

    def __init__(self, browser: Browser, port: int, *, width: int = 900, height: int = 500) -> None:
        self.errors: list[str] = []
        self.page: Page = browser.new_page(viewport={"width": width, "height": height})
        self.page.set_default_timeout(60_000)
        self.page.on("console", self._listen)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        with self.page.expect_console_message(lambda message: message.text.startswith("Connected!")):
            self.page.goto(f"http://127.0.0.1:{port}")
        self._clear()

    def reload(self) -> None:
        """Load the page again."""
        self.page.reload()
        self._clear()

    def _clear(self) -> None:
        self.page.locator("canvas").first.wait_for()
        # viser warns of WebGL in software, over whatever lies at the top left.
        self.page.add_style_tag(content="#webgl-software-rendering { display: none }")

    def close(self) -> None:
        """Close the page."""
        self.page.close()

    def press(self, button: str) -> None:
        """Press the button with this text."""
        self.page.get_by_role("button", name=button, exact=True).click()

    def wait_for_text(self, text: str, *, timeout_s: float = 60) -> None:
        """Wait until the page shows a text.

        Args:
            text: a part of it.
            timeout_s: seconds after which Playwright raises its TimeoutError.
        """
        self.page.get_by_text(text).first.wait_for(timeout=1000 * timeout_s)

    def tick(self, box: str, *, on: bool) -> None:
        """Set the checkbox with this label.

        Args:
            box: its label.
            on: whether it is to be ticked.
        """
        self.page.get_by_label(box, exact=True).set_checked(on, force=True)

    def canvas(self) -> Float[np.ndarray, "H W 3"]:
        """The scene without what lies over it, RGB in [0, 1]."""
        # A notice tells that WebGL runs in software.
        self.page.add_style_tag(content='[class*="Notification"] { display: none !important; }')
        box = self.page.locator("canvas").first.bounding_box()
        assert box is not None
        x, y, width, height = (round(box[name]) for name in ("x", "y", "width", "height"))
        return self.screenshot()[y : y + height, x : x + width]

    def screenshot(self, path: Path | str | None = None) -> Float[np.ndarray, "H W 3"]:
        """The window, RGB in [0, 1].

        Args:
            path: also write it there, as PNG.
        """
        png = self.page.screenshot(path=path)
        image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
        assert image is not None
        return image[..., ::-1].astype(np.float32) / 255

    def _listen(self, message: ConsoleMessage) -> None:
        if message.type == "error" and not message.text.startswith(TOLERATED):
            self.errors.append(message.text)


def similarity(a: Float[np.ndarray, "H W 3"], b: Float[np.ndarray, "H W 3"]) -> float:
    """SSIM of two images with values in [0, 1], over all pixels."""
    return float(ssim(jnp.asarray(a, jnp.float32), jnp.asarray(b, jnp.float32)))
