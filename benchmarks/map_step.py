"""A map step beside a rendering with its gradient, in turns.

    python -m benchmarks.map_step [--calls 15]

The Gaussians are those of `data/bench/splat_scene_50k.npz`, found through SFGS_DATA or at ../shared, in an
image of 320 x 240. *In view* are the Gaussians that the view's camera sees; the rest of the map lies behind
it. Both have the whole map. The rendering gives the gradient of L1; the step that of its loss, with SSIM, and
moves the Gaussians in view by Adam. *Ratio* is the median over turns in which one followed the other.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np

from benchmarks.gate import seconds
from benchmarks.splatting import View as Scene
from benchmarks.splatting import load_view
from sfgs_jax.arrays import keep_freed_memory
from sfgs_jax.geometry import se3
from sfgs_jax.slam import MapParams, OptimisationConfig, SeedingConfig, View, map_step
from sfgs_jax.slam.state import GaussianMap, empty_map
from sfgs_jax.splatting import Gaussians

COUNTS = ((50_000, 100_000), (100_000, 100_000), (50_000, 400_000))
"""Gaussians in view and in the map."""


def behind(scene: Scene) -> Gaussians:
    """The scene's Gaussians, turned to where its camera does not look."""
    half_turn = se3.exp(jnp.array([0, 0, 0, 0, jnp.pi, 0]))
    turn = se3.compose(se3.compose(scene.T_world_cam, half_turn), se3.inverse(scene.T_world_cam))
    return replace(scene.gaussians, means=turn.apply(scene.gaussians.means))


def map_of(scene: Scene, slots: int) -> GaussianMap:
    """A map of so many Gaussians, of which those of the scene are in view."""
    seen, hidden = scene.gaussians, behind(scene)
    more = slots // len(seen.means) - 1
    gaussians = jax.tree.map(lambda a, b: jnp.concatenate([a, *(more * [b])]), seen, hidden)
    return replace(empty_map(slots), gaussians=gaussians)


def view_of(scene: Scene) -> View:
    """The scene's image and the depth of its rendering."""
    out = jax.jit(scene.forward(scene.config()))(scene.gaussians)
    return View(
        rgb=np.asarray(jnp.clip(255 * scene.target, 0, 255), np.uint8),
        depth=np.asarray(out.depth),
        valid=np.ones(out.depth.shape, bool),
        twist=np.zeros(6, np.float32),
        keyframe=0,
        T_keyframe_cam=jaxlie.SE3.identity(),
        frame=0,
        gain=np.ones(3, np.float32),
        correction=np.zeros(6, np.float32),
        extra=False,
    )


def step_of(scene: Scene, slots: int) -> Callable[[], Any]:
    """A call of the map step."""
    params = MapParams(
        camera=scene.camera,
        timing=None,
        mean_gain=jnp.ones(3),
        rate=jnp.ones(()),
        config=OptimisationConfig(),
        seeding=SeedingConfig(),
        pair_capacity=scene.config().pair_capacity,
        view_capacity=len(scene.gaussians.means),
    )
    gaussian_map, view = map_of(scene, slots), view_of(scene)
    found = map_step(params, gaussian_map, view, scene.T_world_cam)
    assert int(found.overflow) == 0
    return lambda: map_step(params, gaussian_map, view, scene.T_world_cam)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="A map step beside a rendering with its gradient.")
    parser.add_argument("--calls", type=int, default=15, help="turns of each")
    options = parser.parse_args()
    keep_freed_memory()  # as the command does
    print("| in view | in the map | rendering with gradient ms | map step ms | ratio |")
    print("| --- | --- | --- | --- | --- |")
    for seen, slots in COUNTS:
        scene = load_view().smaller(2).resampled(seen)
        gradient, gaussians = jax.jit(scene.gradient(scene.config())), map_of(scene, slots).gaussians

        def rendering(gradient: Any = gradient, gaussians: Gaussians = gaussians) -> Any:
            return gradient(gaussians)

        step = step_of(scene, slots)
        seconds(rendering)
        turns = np.asarray([(seconds(rendering), seconds(step)) for _ in range(options.calls)])
        one, other = 1e3 * np.median(turns, axis=0)
        ratio = np.median(turns[:, 1] / turns[:, 0])
        print(f"| {seen:,} | {slots:,} | {one:.1f} | {other:.1f} | {ratio:.2f} |", flush=True)


if __name__ == "__main__":
    main()
