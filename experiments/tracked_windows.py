"""Short windows of frames, tracked by the library, with two errors that have gradients to the network.

One is the error of the tracked poses and needs the truth. The other renders the first frame's surface from
each tracked pose and compares colours. It needs no truth.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Float

from experiments.flat_map import flat_gaussians
from experiments.true_clips import WIDTH, TrueClip, opened, true_clip, with_truth
from sfgs_jax import gicp, slam, splatting
from sfgs_jax.geometry import Camera, se3

KEYPOINTS = 192
FRAMES, STRIDES = 5, (2, 3, 4)
"""Frames of a window, and frames of the recording from one to the next."""
REACH = 2.0
"""Distance of the points whose displacement sums up an error of a pose, metres."""
RENDERER = splatting.RenderConfig(pair_capacity=1 << 15)


class TrackedWindow(NamedTuple):
    """Frames that are tracked from the first.

    Attributes:
        camera: intrinsics.
        rgb, depth: (N, H, W, 3) in [0, 1] and (N, H, W) in metres.
        elapsed: (N,) seconds since the frame before.
        poses: (N, 7) true poses in the first camera, as wxyz_xyz.
        gaussians: surface of the first frame.
    """

    camera: Camera
    rgb: Float[Array, "n H W 3"]
    depth: Float[Array, "n H W"]
    elapsed: Float[Array, " n"]
    poses: Float[Array, "n 7"]
    gaussians: splatting.Gaussians


def tracking(*, use_surface: bool, learned_weights: bool) -> slam.TrackingConfig:
    """Settings for small images: one resolution, few keypoints.

    Args:
        use_surface: whether GICP takes part.
        learned_weights: whether matches weigh by similarity and scores, or all alike.
    """
    features = slam.FeaturesConfig(
        max_keypoints=KEYPOINTS,
        max_rigid_matches=KEYPOINTS // 2,
        match_weights="learned" if learned_weights else "equal",
    )
    surface = gicp.GicpConfig(levels=1, strides=(2,), skipped_halvings=0)
    return slam.TrackingConfig(features=features, gicp=surface, use_surface=use_surface)


def window_of(clip: TrueClip) -> TrackedWindow:
    """A clip as a window."""
    inverse = np.linalg.inv(clip.poses[0])
    poses = se3.parameters_of(inverse @ clip.poses).astype(np.float32)
    # Numbers as arrays: one program serves recordings of one size.
    camera = jax.tree.map(jnp.float32, clip.camera)
    scene = flat_gaussians(clip.rgb[0], clip.depth[0], clip.camera, np.eye(4))
    rgb, depth, elapsed = jnp.asarray(clip.rgb), jnp.asarray(clip.depth), jnp.asarray(clip.elapsed)
    return TrackedWindow(camera, rgb, depth, elapsed, jnp.asarray(poses), scene)


def windows_of(
    name: str, seed: int, count: int, part: tuple[float, float] = (0, 1), width: int = WIDTH
) -> list[TrackedWindow]:
    """Windows at random times of a place or a recording, in order of time.

    Args:
        name: of it.
        seed: of a place, and of the times.
        count: windows.
        part: share of the recording's frames that they lie in, from and to.
        width: columns.
    """
    recording, rng = opened(name, seed, width), np.random.default_rng(seed)
    numbers = with_truth(recording)
    first, last = (round(share * len(numbers)) for share in part)
    starts = np.sort(rng.integers(first, last - max(STRIDES) * (FRAMES - 1), count))
    windows = []
    for index, start in enumerate(starts.tolist()):
        stride = STRIDES[index % len(STRIDES)]
        chosen = numbers[start : start + stride * FRAMES : stride][:FRAMES]
        windows.append(window_of(true_clip(recording, chosen, width)))
    return windows


def tracked(params: slam.TrackerParams, window: TrackedWindow) -> Float[Array, "m 7"]:
    """Tracked poses of all frames but the first, in the first camera, as wxyz_xyz."""
    params = eqx.tree_at(lambda p: p.camera, params, window.camera)
    tracker = slam.init_tracker(params)
    _, found = slam.track_sequence(params, tracker, window.rgb, window.depth, window.elapsed)
    return found.T_world_cam.wxyz_xyz[1:]


def log_errors(params: slam.TrackerParams, window: TrackedWindow) -> Float[Array, " m"]:
    """Logarithms of the tracked poses' errors: displacement of points `REACH` away, plus 1 mm, in metres."""
    found, truth = jaxlie.SE3(tracked(params, window)), jaxlie.SE3(window.poses[1:])
    off = se3.log(se3.compose(se3.inverse(truth), found))
    square = jnp.sum(off[:, :3] ** 2, axis=1) + 2 / 3 * REACH**2 * jnp.sum(off[:, 3:] ** 2, axis=1)
    return jnp.log(jnp.sqrt(square + 1e-10) + 1e-3)


def pose_loss(params: slam.TrackerParams, window: TrackedWindow) -> Float[Array, ""]:
    """Mean of the logarithms of the tracked poses' errors."""
    return jnp.mean(log_errors(params, window))


def image_loss(params: slam.TrackerParams, window: TrackedWindow) -> Float[Array, ""]:
    """Mean logarithm of the colour error of the first frame's surface, rendered from the tracked poses."""

    def colour_error(pose: Float[Array, "7"], rgb: Float[Array, "H W 3"]) -> Float[Array, ""]:
        drawn = splatting.render(window.gaussians, window.camera, jaxlie.SE3(pose), config=RENDERER)
        seen = jax.lax.stop_gradient(drawn.alpha > 0.9)[..., None]
        colour = drawn.rgb / jnp.maximum(drawn.alpha, 0.5)[..., None]
        off = jnp.where(seen, colour - rgb, 0)
        # Exposure differs between frames.
        count = jnp.sum(seen) + 1.0
        off = jnp.where(seen, off - jnp.sum(off, axis=(0, 1)) / count, 0)
        return jnp.sum(jnp.abs(off)) / (3 * count)

    return jnp.mean(jnp.log(jax.vmap(colour_error)(tracked(params, window), window.rgb[1:]) + 1e-3))
