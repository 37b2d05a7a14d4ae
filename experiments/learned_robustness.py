"""Learned robustness: kernel widths and weights by gradient descent on the error of poses.

    python -m experiments.learned_robustness [--seeds 3] [--recordings redkitchen fr1_rpy] [--plot FILE]

Pairs of frames of three synthetic places are registered by keypoints and surface. The camera has the faults
of a Kinect: rolling shutter, late and distorted depth. The gradient of the error descends over four numbers.
They are the widths of both robust kernels, the number of matches that share an error, and the deviation of
the expected motion. Numbers set by hand are the rival, in other places and in real recordings: first in the
same registrations, then in the tracker.

Thresholds decide by steps, so their gradient is exactly zero, and the library's settings are static. The
tracker's threshold of degeneracy is varied instead, and the kernel of the surface is left out.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.flatten_util import ravel_pytree
from jaxtyping import Float
from matplotlib.figure import Figure

from experiments.error_cells import percent
from experiments.matching_tables import print_table
from experiments.robust_registration import (
    NAMES,
    REACH,
    FramePair,
    Robustness,
    by_hand,
    errors,
    frame_pair,
    loss_and_slope,
)
from experiments.true_clips import TrueClip, opened, true_clip, with_truth
from sfgs_jax import slam
from sfgs_jax.geometry import Frame, se3

TRAINING, HELD_OUT = ("room", "twins", "sphere"), ("ring", "wall", "building")
GAPS = (3, 6, 12, 20)
"""Frames from the target of a pair to its source."""
OFF = np.repeat([0.02, 0.02], 3)
"""Standard deviation of the error of the expected motion, metres and radians, per axis."""
STEPS, RATE, BATCH = 40, 0.05, 24
"""Steps of Adam, their size in logarithms, and pairs in each."""
FACTORS = (0.25, 0.5, 2.0, 4.0)
"""Factors on each number, to see whether it matters."""
KEYPOINTS = 256
CLIP, SPAN = 60, 10
"""Frames that are tracked, and frames over which the relative error of a pose is taken."""
TRACKING = slam.TrackingConfig(features=slam.FeaturesConfig(max_keypoints=KEYPOINTS))


def pairs_of(name: str, seed: int, count: int) -> FramePair:
    """Stacked pairs of frames of a place or a recording, at random times.

    Args:
        name: of the place or recording.
        seed: of the place, of the times and of the expected motions.
        count: pairs.
    """
    recording, rng = opened(name, seed, faults=True), np.random.default_rng(seed)
    numbers = with_truth(recording)
    pairs = []
    for index in range(count):
        gap = GAPS[index % len(GAPS)]
        first = int(rng.integers(len(numbers) - gap))
        clip = true_clip(recording, numbers[[first, first + gap]])
        params = slam.tracker_params(clip.camera, TRACKING)
        target, source = (Frame(clip.rgb[i], clip.depth[i], 0.0) for i in (0, 1))
        truth = np.linalg.inv(clip.poses[0]) @ clip.poses[1]
        pairs.append(frame_pair(params, source, target, truth, rng.normal(size=6) * OFF))
    return stacked(pairs)


def stacked(pairs: list[FramePair]) -> FramePair:
    """Pairs of one camera along a leading axis."""
    return jax.tree.map(lambda *x: jnp.stack([jnp.asarray(part) for part in x]), *pairs)


def learned(pairs: FramePair, seed: int, steps: int = STEPS, batch: int = BATCH) -> list[Robustness]:
    """Numbers after each step of the descent, those by hand first.

    Args:
        pairs: stacked, to learn from.
        seed: of the order in which they come.
        steps: of Adam.
        batch: pairs in each.
    """
    path, rng = [by_hand()], np.random.default_rng(seed)
    values, robustness_of = ravel_pytree(by_hand())
    optimiser = optax.adam(optax.cosine_decay_schedule(RATE, steps))
    state = optimiser.init(values)
    for _ in range(steps):
        chosen = rng.choice(len(pairs.guess), batch, replace=False)
        _, slope = loss_and_slope(path[-1], jax.tree.map(lambda x, i=chosen: x[i], pairs))
        # A registration whose problem is singular has no slope.
        slope = jnp.clip(jnp.nan_to_num(ravel_pytree(slope)[0]), -1, 1)
        change, state = optimiser.update(slope, state)
        values = jnp.add(values, jnp.asarray(change))
        path.append(robustness_of(values))
    return path


def log_errors(robustness: Robustness, pairs: FramePair) -> Float[np.ndarray, " n"]:
    """Logarithms of the errors of pairs, which are in millimetres."""
    return np.log(1e3 * np.asarray(errors(robustness, pairs)) + 1e-3)


def scaled(robustness: Robustness, name: str, factor: float) -> Robustness:
    """One number multiplied by a factor."""
    return replace(robustness, **{name: getattr(robustness, name) + jnp.float32(np.log(factor))})


def config_of(robustness: Robustness, observability: float = 1.0) -> slam.TrackingConfig:
    """The tracker's settings with given numbers.

    Args:
        robustness: the numbers.
        observability: factor on the threshold below which the surface leaves a direction free.
    """
    width, surface_width, correlation, sigma = (
        float(np.float32(np.exp(getattr(robustness, name)))) for name in NAMES
    )
    gicp, features = TRACKING.gicp, TRACKING.features
    return replace(
        TRACKING,
        features=replace(
            features,
            kernel_width=width,
            patch_kernel_width=width * features.patch_kernel_width / features.kernel_width,
            correlation=correlation,
        ),
        gicp=replace(
            gicp, kernel_width=surface_width, min_observability=observability * gicp.min_observability
        ),
        motion_model_sigma=sigma,
    )


def tracked_clip(name: str, seed: int) -> TrueClip:
    """Frames in a row of a place or a recording.

    They begin after a sixth of it. From there the hard places have something to start from.
    """
    recording = opened(name, seed, faults=True)
    numbers = with_truth(recording)
    first = (len(numbers) - CLIP) // 6
    return true_clip(recording, numbers[first : first + CLIP])


def tracked_log_errors(clip: TrueClip, config: slam.TrackingConfig) -> Float[np.ndarray, " n"]:
    """Logarithms of the relative errors over `SPAN` frames of a tracked clip, in millimetres, as of pairs."""
    # Numbers as arrays: one program serves recordings of one size.
    params = slam.tracker_params(jax.tree.map(jnp.float32, clip.camera), config)
    tracker = slam.init_tracker(params)
    _, found = slam.track_sequence(params, tracker, clip.rgb, clip.depth, clip.elapsed)
    poses = se3.to_matrices(found.T_world_cam)
    moved, true = (np.linalg.inv(p[:-SPAN]) @ p[SPAN:] for p in (poses, clip.poses))
    off = se3.logs_of(np.linalg.inv(true) @ moved)
    squares = np.sum(off[:, :3] ** 2, axis=1) + 2 / 3 * REACH**2 * np.sum(off[:, 3:] ** 2, axis=1)
    return np.log(1e3 * np.sqrt(squares) + 1e-3)


def pair_rows(found: list[Robustness], names: tuple[str, ...], count: int) -> list[tuple[str, ...]]:
    """Errors of held-out pairs by hand and learned; seeds differ from those of the training."""
    rows = []
    for name in names:
        before, changes = [], []
        for seed, robustness in enumerate(found):
            pairs = pairs_of(name, 100 + seed, count)
            hand = log_errors(by_hand(), pairs)
            before.append(np.exp(hand.mean()))
            changes.append(log_errors(robustness, pairs) - hand)
        by_seed = np.asarray([change.mean() for change in changes])
        rows.append((name, f"{np.mean(before):.2f}", percent(np.concatenate(changes)), percent(by_seed)))
    return rows


def track_rows(found: list[Robustness], names: tuple[str, ...]) -> list[tuple[str, ...]]:
    """Errors in the tracker by hand, learned, without a kernel, and with other thresholds of degeneracy."""
    hand = config_of(by_hand())
    others = [
        replace(hand, gicp=replace(hand.gicp, kernel="none")),
        *(config_of(by_hand(), factor) for factor in (0.1, 10.0)),
    ]
    variants = [[config_of(robustness) for robustness in found]]
    variants += [[other] * len(found) for other in others]
    rows = []
    for name in names:
        clips = [tracked_clip(name, 100 + seed) for seed in range(len(found))]
        before = [tracked_log_errors(clip, hand).mean() for clip in clips]
        cells = [f"{np.mean(np.exp(before)):.2f}"]
        for configs in variants:
            after = [tracked_log_errors(*given).mean() for given in zip(clips, configs, strict=True)]
            cells.append(percent(np.asarray(after) - before))
        rows.append((name, *cells))
    return rows


def factor_rows(pairs: FramePair) -> list[tuple[str, ...]]:
    """Change of the error of pairs when one number is changed; by one program, for they are its inputs."""
    base = log_errors(by_hand(), pairs)
    return [
        (name, *(percent(log_errors(scaled(by_hand(), name, factor), pairs) - base) for factor in FACTORS))
        for name in NAMES
    ]


def plot(paths: list[list[Robustness]], path: Path) -> None:
    """The numbers over the descent, a line a seed."""
    figure = Figure(figsize=(9, 2.4), layout="constrained")
    for axes, name in zip(figure.subplots(1, len(NAMES)), NAMES, strict=True):
        for numbers in paths:
            axes.semilogy([float(np.exp(getattr(r, name))) for r in numbers], linewidth=1)
        axes.axhline(float(np.exp(getattr(by_hand(), name))), color="grey", linestyle=":", linewidth=1)
        axes.set(title=name.replace("_", " "), xlabel="step")
    figure.savefig(path)


def main() -> None:
    """Print the tables and draw the plot."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--pairs", type=int, default=24, help="to learn from, of each place")
    parser.add_argument("--held-out", type=int, default=16, help="pairs to judge by, of each place")
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--recordings", nargs="*", default=["redkitchen", "fr1_rpy"])
    parser.add_argument("--plot", type=Path, default=Path("learned_robustness.svg"))
    arguments = parser.parse_args()
    paths, every = [], []
    for seed in range(arguments.seeds):
        places = [pairs_of(name, seed, arguments.pairs) for name in TRAINING]
        pairs = jax.tree.map(lambda *x: jnp.concatenate(x), *places)
        paths.append(learned(pairs, seed, arguments.steps))
        every.append(pairs)
    plot(paths, arguments.plot)
    found = [path[-1] for path in paths]
    rows = [("by hand", *(f"{np.exp(getattr(by_hand(), name)):.2f}" for name in NAMES))]
    for seed, robustness in enumerate(found):
        rows.append((f"seed {seed}", *(f"{np.exp(getattr(robustness, name)):.2f}" for name in NAMES)))
    print_table("Numbers", ("", *(name.replace("_", " ") for name in NAMES)), rows)
    names = (*TRAINING, *HELD_OUT, *arguments.recordings)
    columns = ("place", "by hand mm", "learned %, over pairs", "learned %, over seeds")
    rows = pair_rows(found, names, arguments.held_out)
    print_table("Error of held-out pairs; places have other seeds", columns, rows)
    columns = ("number", *(f"x {factor:g} %" for factor in FACTORS))
    pairs = jax.tree.map(lambda *x: jnp.concatenate(x), *every)
    print_table("Error of all training pairs with one number changed", columns, factor_rows(pairs))
    columns = (
        "place",
        "by hand mm",
        "learned %",
        "no surface kernel %",
        "min_observability / 10 %",
        "x 10 %",
    )
    print_table(f"Relative error over {SPAN} tracked frames, over seeds", columns, track_rows(found, names))


if __name__ == "__main__":
    main()
