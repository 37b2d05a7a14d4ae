"""Time until a browser shows a map, and images a second while the view moves, by number of Gaussians.

    python -m benchmarks.viewer_page [--gaussians 100000 300000 500000] [--drawn-by browser library]

The browser is headless and has WebGL in software on the same processors. A graphics card draws many times as
many images; this is what a browser without one gets. The map is a box of random colours, seen from within.
An image counts once the page has drawn it, or has received it from the library.
"""

import argparse
import math
import tempfile
import time
from pathlib import Path
from typing import Literal, get_args

import cv2
import jax.numpy as jnp
import numpy as np
from playwright.sync_api import Browser, Page

from sfgs_jax.splatting import Gaussians, save_ply
from sfgs_jax.viewer import view_run
from tests.viewer.browser import OpenPage, find_chromium, headless

Drawer = Literal["browser", "library"]
_WARM_UP_S, _COUNTED_S = 20.0, 10.0
_COVERAGE = 0.5
"""Square of a Gaussian's standard deviation over its share of the surface."""
_PATIENCE_S = 120
_LEAST_IMAGE = 3000
"""Bytes of a message that holds an image; others are shorter."""

_COUNT_DRAWN = """() => {
    window.drawn = 0;
    const type = WebGL2RenderingContext.prototype, draw = type.drawElementsInstanced;
    type.drawElementsInstanced = function (...a) { window.drawn++; return draw.apply(this, a); };
}"""


def box(count: int) -> Gaussians:
    """Gaussians that cover the six sides of a cube of 4 metres, at random places."""
    rng = np.random.default_rng(0)
    means = rng.uniform(-2, 2, (count, 3))
    side = rng.integers(0, 3, count)
    means[np.arange(count), side] = np.where(rng.random(count) < 0.5, -2, 2)
    return Gaussians(
        means=jnp.asarray(means, jnp.float32),
        quaternions=jnp.asarray(rng.normal(size=(count, 4)), jnp.float32),
        log_scales=jnp.full((count, 3), 0.5 * np.log(_COVERAGE * 6 * 4**2 / count), jnp.float32),
        opacity_logits=jnp.full(count, 2.0),
        sh=jnp.asarray(rng.normal(size=(count, 1, 3)), jnp.float32),
        valid=jnp.ones(count, bool),
    )


def shows_the_map(page: Page) -> bool:
    """Whether most of the canvas has another colour than viser's dark grey or black."""
    image = cv2.imdecode(np.frombuffer(page.locator("canvas").first.screenshot(), np.uint8), cv2.IMREAD_COLOR)
    return image is not None and float(np.mean(image > 60)) > 0.3


def drag(page: Page, seconds: float) -> None:
    """Turn the view with the mouse for a while."""
    start = time.perf_counter()
    while (passed := time.perf_counter() - start) < seconds:
        page.mouse.move(400 + 200 * math.sin(passed), 250)
        page.wait_for_timeout(20)


def row(browser: Browser, count: int, drawer: Drawer, folder: Path) -> str:
    """A row of the table: times in seconds."""
    path = folder / f"{count}.ply"
    save_ply(path, box(count))
    start = time.perf_counter()
    scene = view_run(path, port=0, max_gaussians=count, drawn_by=drawer, block=False)
    first = scene.server.initial_camera
    first.position, first.look_at, first.up = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)
    opened = OpenPage(browser, scene.server.get_port())
    page, received = opened.page, []
    page.on("websocket", lambda socket: socket.on("framereceived", lambda data: received.append(len(data))))
    opened.reload()
    while not shows_the_map(page):
        if time.perf_counter() - start > _PATIENCE_S:
            raise SystemExit(f"{count} Gaussians, drawn by the {drawer}, did not appear in {_PATIENCE_S} s")
        time.sleep(0.1)
    shown = time.perf_counter() - start
    page.evaluate(_COUNT_DRAWN)
    page.mouse.move(400, 250)
    page.mouse.down()
    drag(page, _WARM_UP_S)
    before = page.evaluate("window.drawn"), len(received)
    drag(page, _COUNTED_S)
    drawn = page.evaluate("window.drawn") - before[0]
    sent = sum(size > _LEAST_IMAGE for size in received[before[1] :])
    opened.close()
    scene.close()
    rate = (drawn if drawer == "browser" else sent) / _COUNTED_S
    return f"| {count} | {drawer} | {shown:.1f} | {rate:.1f} |"


def main() -> None:
    """Print a row for each size and drawer."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--gaussians", type=int, nargs="+", default=[100_000, 300_000, 500_000])
    parser.add_argument("--drawn-by", nargs="+", default=get_args(Drawer), choices=get_args(Drawer))
    options = parser.parse_args()
    program = find_chromium()
    if program is None:
        raise SystemExit("no browser is installed")
    print("| Gaussians | drawn by | shown, s | images/s |\n| --- | --- | --- | --- |")
    with headless(program) as browser, tempfile.TemporaryDirectory() as folder:
        for count in options.gaussians:
            for drawer in options.drawn_by:
                print(row(browser, count, drawer, Path(folder)), flush=True)


if __name__ == "__main__":
    main()
