"""Self-calibration: focal lengths, extrinsic, times and depth distortion by descent, without truth.

    python -m experiments.self_calibration [--seeds 3] [--recordings redkitchen fr1_rpy] [--plot FILE]

A recording of the synthetic room with a Kinect's faults is tracked with focal lengths 5 % too long. The rest
of the calibration begins 2 cm, 2 degrees and 20 ms from the truth, in random directions. Gauss-Newton on the
joint error of pairs of frames, of keypoints and surface, finds calibration and poses together; its
derivatives are JAX's. Then the frames are tracked again with the calibration found, for the motion of their
rows, and so on. In the last two rounds the brightness of pixels takes the place of the keypoints.

Real recordings have no truth to compare with. They are judged by cycles of three registrations in frames that
the calibration has not seen. There are three rows: as recorded, with the wrong start, and as found.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Float
from matplotlib.figure import Figure

from experiments.calibration_model import (
    Calibration,
    Pair,
    View,
    calibrated,
    nothing_wrong,
    registered,
    step,
)
from experiments.matching_tables import print_table
from experiments.recordings import SOURCES
from sfgs_jax import datasets, slam
from sfgs_jax.geometry import Camera, downscale_depth, downscale_rgb, se3, surface
from sfgs_jax.superfeats import extract, load_weights, match, mean_grey

FOCAL_ERROR, SHIFT_ERROR, TURN_ERROR, DELAY_ERROR = 0.05, 0.02, np.radians(2.0), 0.02
WIDTH = 320
"""Columns that real images are reduced to, and that synthetic ones have. At 160 the shift stays 1.5 to 2.2 mm
off, a tenth of a pixel."""
EVERY, GAPS = 4, (1, 2, 4)
"""Frames from one view to the next, and views from one of a pair to the other."""
KEYPOINTS = 512


class Round(NamedTuple):
    """Steps of Gauss-Newton after a tracking.

    Attributes:
        width: of the robust kernel, standard deviations.
        bright: share of the brightness of pixels in place of keypoints.
        steps: how many.
    """

    width: float
    bright: float
    steps: int


ROUNDS = (Round(8.0, 0.0, 5), Round(3.0, 0.0, 5), Round(2.0, 1.0, 10), Round(2.0, 1.0, 10))
"""While the start is pixels away, brightness fits at wrong places too. It needs more steps than keypoints:
with five a round fr1_rpy ended far from where it rests."""


class Clip(NamedTuple):
    """Frames in a row at the size in use.

    Attributes:
        camera: their intrinsics.
        rgb, depth: (N, H, W, 3) and (N, H, W).
        elapsed: (N,) seconds since the frame before.
    """

    camera: Camera
    rgb: Float[np.ndarray, "n H W 3"]
    depth: Float[np.ndarray, "n H W"]
    elapsed: Float[np.ndarray, " n"]


def clip_of(recording: datasets.Recording, first: int, count: int, width: int = WIDTH) -> Clip:
    """Frames of a recording, reduced to a width.

    Args:
        recording: whose width is a multiple of it.
        first: number of the first frame.
        count: frames.
        width: columns.
    """
    factor = recording.camera.width // width
    frames = [recording[i] for i in range(first, first + count)]
    rgb = [np.asarray(downscale_rgb(jnp.asarray(f.rgb), factor) if factor > 1 else f.rgb) for f in frames]
    depth = [np.asarray(_smaller(jnp.asarray(f.depth), factor)) for f in frames]
    times = np.asarray([f.timestamp for f in frames])
    elapsed = np.diff(times, prepend=times[:1]).astype(np.float32)
    camera = recording.camera.downscaled(factor) if factor > 1 else recording.camera
    return Clip(camera, np.stack(rgb), np.stack(depth), elapsed)


def _smaller(depth: jax.Array, factor: int) -> jax.Array:
    return downscale_depth(depth, factor) if factor > 1 else depth


def tracked(clip: Clip, camera: Camera) -> Float[np.ndarray, "n 4 4"]:
    """Poses of a clip's frames, tracked with a camera; a lost frame has its last known one."""
    params = slam.tracker_params(camera, slam.TrackingConfig())
    tracker = slam.init_tracker(params)
    _, found = slam.track_sequence(params, tracker, clip.rgb, clip.depth, clip.elapsed)
    return se3.to_matrices(found.T_world_cam)


def twists(poses: Float[np.ndarray, "n 4 4"], elapsed: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 6"]:
    """Motion per second of each frame, from the frame before it to the frame after; 0 at the ends."""
    moved = se3.logs_of(np.linalg.inv(poses[:-2]) @ poses[2:])
    seconds = (elapsed[1:-1] + elapsed[2:])[:, None]
    return np.pad(moved / np.maximum(seconds, 1e-3), ((1, 1), (0, 0))).astype(np.float32)


class Scene(NamedTuple):
    """Views of a clip without their motion, their matches, and the frames that they are."""

    views: View
    pairs: Pair
    frames: Float[np.ndarray, " m"]


def scene_of(clip: Clip, keypoints: int = KEYPOINTS) -> Scene:
    """Every fourth frame of a clip as a view, and the matches of pairs of them."""
    frames = np.arange(1, len(clip.rgb) - 1, EVERY)
    network = load_weights()
    features = [
        extract(network, mean_grey(jnp.asarray(clip.rgb[i])), max_keypoints=keypoints) for i in frames
    ]
    planes, valid = zip(*(_planes(jnp.asarray(clip.depth[i]), clip.camera) for i in frames), strict=True)
    views = View(
        jnp.stack(planes),
        jnp.stack(valid),
        jnp.stack([f.keypoints for f in features]),
        jnp.stack([_contrast(clip.rgb[i]) for i in frames]),
        jnp.zeros((len(frames), 6)),
    )
    pairs = []
    for gap in GAPS:
        for a in range(len(frames) - gap):
            m = match(features[a], features[a + gap])
            pairs.append(Pair(jnp.asarray(a), jnp.asarray(a + gap), jnp.where(m.valid, m.index_b, -1)))
    return Scene(views, jax.tree.map(lambda *x: jnp.stack(x), *pairs), frames)


def _contrast(rgb: Float[np.ndarray, "H W 3"]) -> Float[jax.Array, "H W"]:
    """Brightness without its slow changes, and without a contrast that exposure could change."""
    grey = rgb.mean(axis=-1)
    band = cv2.GaussianBlur(grey, (0, 0), 1.0) - cv2.GaussianBlur(grey, (0, 0), 5.0)
    return jnp.asarray(band / np.sqrt(cv2.GaussianBlur(band**2, (0, 0), 8.0) + 0.01**2))


@jax.jit
def _planes(depth: jax.Array, camera: Camera) -> tuple[jax.Array, jax.Array]:
    """Inverse depth of the plane at each pixel with its slopes along u and v, and where there is one."""
    found = surface(depth, camera)
    normals, points = found.normals, found.points
    height = jnp.where(found.valid, jnp.sum(normals * points, axis=-1), -1)
    inverse = 1 / jnp.where(found.valid, points[..., 2], 1)
    slopes = normals[..., 0] / camera.fx / height, normals[..., 1] / camera.fy / height
    return jnp.stack([inverse, *slopes], axis=-1), found.valid


class Found(NamedTuple):
    """A calibration with its standard deviations, and those on the way to it."""

    calibration: Calibration
    deviations: Calibration
    path: list[Calibration]


def calibrate(clip: Clip, scene: Scene, start: Calibration, rounds: Sequence[Round] = ROUNDS) -> Found:
    """Descend from a calibration on the joint error of a clip.

    Args:
        clip: its frames.
        scene: its views and pairs.
        start: where to begin; the mean of the prior as well.
        rounds: each after a tracking.
    """
    calibration, path, covariance = start, [start], None
    for width, bright, steps in rounds:
        poses, views = _posed(clip, scene, calibration)
        for _ in range(steps):
            settings = jnp.float32(width), jnp.float32(bright)
            after = step(clip.camera, calibration, start, poses, views, scene.pairs, *settings)
            calibration, poses, covariance = after.calibration, after.poses, after.covariance
            path.append(calibration)
    assert covariance is not None
    _, unravel = ravel_pytree(calibration)
    return Found(calibration, unravel(jnp.sqrt(jnp.diagonal(covariance))), path)


def _posed(clip: Clip, scene: Scene, calibration: Calibration) -> tuple[jax.Array, View]:
    """Poses of the views as they are tracked, and the views with their motion."""
    poses = tracked(clip, calibrated(clip.camera, calibration))
    motion = jnp.asarray(twists(poses, clip.elapsed)[scene.frames])
    views = replace(scene.views, twist=motion)
    return jnp.asarray(se3.parameters_of(poses[scene.frames]), jnp.float32), views


def wrong(rng: np.random.Generator, truth: Calibration) -> Calibration:
    """A calibration as wrong as the descent is to begin; readouts and distortion are unknown, 0."""
    directions = rng.normal(size=(2, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    error = np.concatenate([SHIFT_ERROR * directions[0], TURN_ERROR * directions[1]])
    off = se3.compose(se3.exp(truth.colour_depth), se3.exp(jnp.asarray(error, jnp.float32)))
    delay = truth.times[0] + DELAY_ERROR * rng.choice([-1, 1])
    return replace(
        nothing_wrong(),
        log_focal=truth.log_focal + jnp.log1p(jnp.float32(FOCAL_ERROR)),
        colour_depth=se3.log(off),
        times=jnp.stack([delay, jnp.zeros(()), jnp.zeros(())]),
    )


def truth_of(recording: datasets.SyntheticRecording) -> Calibration:
    """The calibration that the faults of a recording ask for, but for the distortion of depth."""
    faults = recording.faults or datasets.KinectFaults()
    T = se3.log(se3.from_matrix(recording.T_colour_depth))
    times = jnp.asarray([faults.depth_delay, faults.colour_readout, faults.depth_readout], jnp.float32)
    return replace(nothing_wrong(), colour_depth=T, times=times)


NAMES = (
    "focal x %",
    "focal y %",
    "shift mm",
    "turn deg",
    "delay ms",
    "colour readout ms",
    "depth readout ms",
)


def errors(found: Calibration, truth: Calibration) -> Float[np.ndarray, "7"]:
    """Errors of a calibration in the order and the units of `NAMES`."""
    off = se3.log(se3.compose(se3.inverse(se3.exp(truth.colour_depth)), se3.exp(found.colour_depth)))
    shift, turn = (float(jnp.linalg.norm(part)) for part in (off[:3], off[3:]))
    focal = 100 * np.abs(np.expm1(np.asarray(found.log_focal - truth.log_focal)))
    times = 1e3 * np.abs(np.asarray(found.times - truth.times))
    return np.asarray([*focal, 1e3 * shift, np.degrees(turn), *times])


def cycles(clip: Clip, scene: Scene, calibration: Calibration) -> tuple[float, float]:
    """Median errors of the motions around three views in a row, millimetres and degrees."""
    poses, views = _posed(clip, scene, calibration)
    width = jnp.float32(ROUNDS[-1].width)
    motions = np.asarray(registered(clip.camera, calibration, poses, views, scene.pairs, width))
    found = dict(
        zip(
            zip(scene.pairs.first.tolist(), scene.pairs.second.tolist(), strict=True),
            se3.matrices_of(motions),
            strict=True,
        )
    )
    around = [
        np.linalg.inv(found[k, k + 2]) @ found[k + 1, k + 2] @ found[k, k + 1]
        for k in range(len(scene.frames) - 2)
    ]
    off = se3.logs_of(np.stack(around))
    lengths, angles = (np.linalg.norm(part, axis=1) for part in (off[:, :3], off[:, 3:]))
    return 1e3 * float(np.median(lengths)), float(np.degrees(np.median(angles)))


class Descent(NamedTuple):
    """Errors on the way of a descent, in the order of `NAMES`, and deviations that it claims at its end."""

    errors: Float[np.ndarray, "steps 7"]
    deviations: Float[np.ndarray, "7"]


def synthetic(seed: int, frames: int, width: int = WIDTH, rounds: Sequence[Round] = ROUNDS) -> Descent:
    """Descent on the room with a Kinect's faults, from a wrong start of the same seed."""
    recording = datasets.SyntheticRecording(
        num_frames=frames,
        width=width,
        height=width * 3 // 4,
        seed=seed,
        noise=True,
        faults=datasets.KINECT_V1,
    )
    clip, truth = clip_of(recording, 0, frames, width), truth_of(recording)
    found = calibrate(clip, scene_of(clip), wrong(np.random.default_rng(seed), truth), rounds)
    sigma = found.deviations
    parts = sigma.colour_depth[:3], sigma.colour_depth[3:]
    shift, turn = (float(jnp.linalg.norm(part)) for part in parts)
    deviations = [*(100 * sigma.log_focal), 1e3 * shift, np.degrees(turn), *(1e3 * sigma.times)]
    return Descent(np.stack([errors(c, truth) for c in found.path]), np.asarray(deviations, float))


def synthetic_rows(descents: list[Descent], seeds: int, frames: int) -> Iterator[tuple[str, ...]]:
    """Rows of the synthetic room, a descent each, their mean, and what they claim; the descents are kept."""
    for seed in range(seeds):
        descents.append(synthetic(seed, frames))
        first, end = descents[-1].errors[[0, -1]]
        if seed == 0:
            yield "start", *(f"{x:.1f}" for x in first)
        yield f"seed {seed}", *(f"{x:.2f}" for x in end)
    ends = np.stack([d.errors[-1] for d in descents])
    spread = ends.std(axis=0, ddof=1) / np.sqrt(len(ends)) if len(ends) > 1 else np.full(7, np.nan)
    yield "mean", *(f"{m:.2f} ± {e:.2f}" for m, e in zip(ends.mean(axis=0), spread, strict=True))
    claimed = np.stack([d.deviations for d in descents])
    yield "claimed deviation", *(f"{x:.2f}" for x in claimed.mean(axis=0))


def real(name: str, seeds: int, frames: int) -> Iterator[tuple[str, ...]]:
    """Rows of a recording: its held-out cycles as it is calibrated, and before and after each descent."""
    recording = datasets.open_recording(SOURCES[name])
    seen, unseen = (clip_of(recording, first, frames) for first in (0, frames))
    seen_scene, unseen_scene = scene_of(seen), scene_of(unseen)

    def row(label: str, calibration: Calibration) -> tuple[str, ...]:
        length, angle = cycles(unseen, unseen_scene, calibration)
        values = errors(calibration, nothing_wrong())
        signed = 100 * np.expm1(np.asarray(calibration.log_focal))
        times = 1e3 * np.asarray(calibration.times)
        numbers = [*signed, *values[2:4], *times]
        return (name, label, f"{length:.1f}", f"{angle:.3f}", *(f"{x:.2f}" for x in numbers))

    yield row("as recorded", nothing_wrong())
    for seed in range(seeds):
        start = wrong(np.random.default_rng(seed), nothing_wrong())
        yield row(f"start {seed}", start)
        yield row(f"found {seed}", calibrate(seen, seen_scene, start).calibration)


def plot(descents: list[Descent], path: Path) -> None:
    """Errors of focal length, extrinsic and delay against steps, one line a seed."""
    figure = Figure(figsize=(9, 2.6), layout="constrained")
    for axes, column, limit in zip(figure.subplots(1, 4), (0, 2, 3, 4), (0.3, 2, 0.1, 2), strict=True):
        for descent in descents:
            axes.semilogy(np.maximum(descent.errors[:, column], 1e-3), linewidth=1)
        axes.axhline(limit, color="grey", linestyle=":", linewidth=1)
        axes.set(title=f"error of {NAMES[column]}", xlabel="step")
    figure.savefig(path)


def main() -> None:
    """Print the tables and draw the plot."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--frames", type=int, default=160, help="of the synthetic recording")
    parser.add_argument(
        "--real-frames", type=int, default=100, help="to calibrate by, and as many to judge by"
    )
    parser.add_argument("--recordings", nargs="*", default=["redkitchen", "fr1_rpy"], choices=sorted(SOURCES))
    parser.add_argument("--plot", type=Path, default=Path("self_calibration.svg"))
    arguments = parser.parse_args()
    if arguments.seeds:
        title = "Errors of the calibration on the Kinect-fault room"
        descents: list[Descent] = []
        print_table(title, ("", *NAMES), synthetic_rows(descents, arguments.seeds, arguments.frames))
        plot(descents, arguments.plot)
    if arguments.recordings:
        title = "Cycles of held-out frames; the calibration relative to the recording's own"
        tables = (real(name, arguments.seeds, arguments.real_frames) for name in arguments.recordings)
        print_table(title, ("recording", "calibration", "cycle mm", "cycle deg", *NAMES), chain(*tables))


if __name__ == "__main__":
    main()
