"""Time until a browser shows a map, and how often it draws the map in a second, by number of Gaussians.

    python -m benchmarks.viewer_page [--gaussians 100000 300000 500000]

The browser is headless and has WebGL in software on the same processors, so its frames a second are a lower
bound: any graphics card draws many times as many. The map is a box around the camera, of random colours.
"""

import argparse
import tempfile
import time
from pathlib import Path

import cv2
import jax.numpy as jnp
import numpy as np
from playwright.sync_api import Browser, Page

from sfgs_jax.splatting import Gaussians, save_ply
from sfgs_jax.viewer import view_run
from tests.viewer.browser import OpenPage, find_chromium, headless

_COUNT_FRAMES = """() => new Promise(done => {
    let frames = 0, start = performance.now();
    const count = () => {
        frames++;
        performance.now() - start > 5000 ? done(frames / 5) : requestAnimationFrame(count);
    };
    requestAnimationFrame(count);
})"""


def box(count: int) -> Gaussians:
    """Gaussians on the six sides of a cube of 4 metres."""
    rng = np.random.default_rng(0)
    means = rng.uniform(-2, 2, (count, 3))
    side = rng.integers(0, 3, count)
    means[np.arange(count), side] = np.where(rng.random(count) < 0.5, -2, 2)
    return Gaussians(
        means=jnp.asarray(means, jnp.float32),
        quaternions=jnp.asarray(rng.normal(size=(count, 4)), jnp.float32),
        log_scales=jnp.full((count, 3), np.log(0.006), jnp.float32),
        opacity_logits=jnp.full(count, 2.0),
        sh=jnp.asarray(rng.normal(size=(count, 1, 3)), jnp.float32),
        valid=jnp.ones(count, bool),
    )


def share_drawn(page: Page) -> float:
    """Share of the canvas that is not white."""
    image = cv2.imdecode(np.frombuffer(page.locator("canvas").first.screenshot(), np.uint8), cv2.IMREAD_COLOR)
    return 0.0 if image is None else float(np.mean(image.min(axis=-1) < 230))


def row(browser: Browser, count: int, folder: Path) -> str:
    """A row of the table: times in seconds."""
    path = folder / f"{count}.ply"
    save_ply(path, box(count))
    start = time.perf_counter()
    scene = view_run(path, port=0, max_gaussians=count, block=False)
    served = time.perf_counter() - start
    page = OpenPage(browser, scene.server.get_port())
    while share_drawn(page.page) < 0.5:
        time.sleep(0.1)
    shown = time.perf_counter() - start
    rate = page.page.evaluate(_COUNT_FRAMES)
    page.close()
    scene.close()
    return f"| {count} | {served:.1f} | {shown:.1f} | {rate:.1f} |"


def main() -> None:
    """Print a row for each size."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--gaussians", type=int, nargs="+", default=[100_000, 300_000, 500_000])
    options = parser.parse_args()
    program = find_chromium()
    if program is None:
        raise SystemExit("no browser is installed")
    print("| Gaussians | served, s | shown, s | frames/s |\n| --- | --- | --- | --- |")
    with headless(program) as browser, tempfile.TemporaryDirectory() as folder:
        for count in options.gaussians:
            print(row(browser, count, Path(folder)), flush=True)


if __name__ == "__main__":
    main()
