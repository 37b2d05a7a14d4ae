"""Learning through the tracker: description and reliability by the gradient of tracked poses and renderings.

    python -m experiments.learn_through_slam [--seeds 3] [--recordings redkitchen fr1_rpy] [--plot FILE]

SuperFeats' description and reliability are trained further through `slam.track_sequence`, with matches that
weigh by them. Detection stays as it is. Windows of five frames are tracked by keypoints alone, for surface
leaves them little to decide. The windows come from synthetic places and from the first part of real
recordings. One training follows the error of their poses. The other follows the error of rendered images and
needs no truth.

Both are judged by the tracked poses of places with other seeds, and of the last half of the real recordings.
These are found by keypoints alone and with the surface, with matches that weigh by the network and alike.
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float
from matplotlib.figure import Figure

from experiments.error_cells import standard_error
from experiments.matching_tables import print_table
from experiments.tracked_windows import (
    TrackedWindow,
    image_loss,
    log_errors,
    pose_loss,
    tracking,
    windows_of,
)
from sfgs_jax import slam
from sfgs_jax.superfeats import load_weights
from sfgs_jax.superfeats.network import Network

TRAINING, OTHERS = ("room", "ring", "twins"), ("wall", "sphere")
TRAINING_PART, HELD_OUT_PART = (0.0, 0.4), (0.5, 1.0)
"""Shares of the frames of real recordings."""
STEPS, RATE, BATCH = 150, 3e-5, 4
"""Steps of Adam, their first size, and windows in each."""
BLOCKS = 12
"""Blocks of time that the windows of a recording are counted as."""
LOSSES = {"poses": pose_loss, "images": image_loss}
TRACKERS = {
    "keypoints alone": tracking(use_surface=False, learned_weights=True),
    "with surface": tracking(use_surface=True, learned_weights=True),
    "keypoints alone, equal weights": tracking(use_surface=False, learned_weights=False),
    "with surface, equal weights": tracking(use_surface=True, learned_weights=False),
}


def trained_parts(network: Network) -> Network:
    """Which arrays are trained, as booleans: all but those of detection."""
    nothing = jax.tree.map(lambda _: False, network)

    def parts(n: Network) -> tuple:
        return n.levels, n.fusions, n.describe, n.rely

    return eqx.tree_at(parts, nothing, jax.tree.map(lambda _: True, parts(network)))


class Training(NamedTuple):
    """A network after training, and the mean loss of each step."""

    network: Network
    losses: list[float]


Loss = Callable[[slam.TrackerParams, TrackedWindow], Array]


def train(
    loss: Loss,
    windows: list[TrackedWindow],
    seed: int,
    config: slam.TrackingConfig = TRACKERS["keypoints alone"],
    steps: int = STEPS,
    rate: float = RATE,
) -> Training:
    """Train the shipped network on windows.

    Args:
        loss: of the parameters of tracking and a window.
        windows: to train on, of one size.
        seed: of their order.
        config: of tracking.
        steps: of Adam.
        rate: size of its first steps; it falls to 0 along a cosine.
    """
    params = slam.tracker_params(windows[0].camera, config)
    assert params.network is not None
    moving, held = eqx.partition(params.network, trained_parts(params.network))
    optimiser = optax.adam(optax.cosine_decay_schedule(rate, steps))
    state, rng, losses = optimiser.init(moving), np.random.default_rng(seed), []

    # One program instead of one for each operation and each array's shape.
    @jax.jit
    def moved(moving: Network, state: optax.OptState, slopes: tuple[Network, ...]) -> tuple:
        mean = jax.tree.map(lambda *x: sum(x) / len(x), *slopes)
        change, state = optimiser.update(mean, state)
        return eqx.apply_updates(moving, change), state

    for _ in range(steps):
        chosen = rng.choice(len(windows), min(BATCH, len(windows)), replace=False)
        found = [_value_and_slope(loss, moving, held, params, windows[i]) for i in chosen]
        values, slopes = zip(*found, strict=True)
        moving, state = moved(moving, state, slopes)
        losses.append(float(np.mean(values)))
    return Training(eqx.combine(moving, held), losses)


@eqx.filter_jit
def _value_and_slope(
    loss: Loss, moving: Network, held: Network, params: slam.TrackerParams, window: TrackedWindow
) -> tuple[Array, Network]:
    def of(moving: Network) -> Array:
        return loss(with_network(params, eqx.combine(moving, held)), window)

    value, slope = eqx.filter_value_and_grad(of)(moving)
    return value, bounded(slope)


def bounded(slope: Network) -> Network:
    """A window's gradient with a length of at most 1, so that no lost window decides; 0 if not finite."""
    length = jnp.sqrt(sum(jnp.sum(x**2) for x in jax.tree.leaves(slope)))
    scale = jnp.where(jnp.isfinite(length), 1 / jnp.maximum(length, 1), 0)
    return jax.tree.map(lambda x: jnp.where(jnp.isfinite(length), x * scale, 0), slope)


def with_network(params: slam.TrackerParams, network: Network) -> slam.TrackerParams:
    """Parameters of tracking with another network."""
    return eqx.tree_at(lambda p: p.network, params, network)


_errors = eqx.filter_jit(log_errors)


def judged(
    network: Network, windows: list[TrackedWindow], config: slam.TrackingConfig
) -> Float[np.ndarray, " n"]:
    """Mean logarithm of the errors of each window's poses, metres."""
    params = with_network(slam.tracker_params(windows[0].camera, config), network)
    return np.asarray([float(jnp.mean(_errors(params, window))) for window in windows])


class Held(NamedTuple):
    """Windows to judge by, a list for each place or recording."""

    windows: dict[str, list[TrackedWindow]]

    def errors(self, network: Network, tracker: str) -> dict[str, np.ndarray]:
        """Mean logarithms of the errors of each window, by one of `TRACKERS`."""
        return {name: judged(network, w, TRACKERS[tracker]) for name, w in self.windows.items()}


def held_out(recordings: list[str], count: int) -> Held:
    """Windows of places with other seeds, and twice as many of the last half of real recordings."""
    windows = {name: windows_of(name, 100, count) for name in (*TRAINING, *OTHERS)}
    for name in recordings:
        windows[name] = windows_of(name, 100, 2 * count, HELD_OUT_PART)
    return Held(windows)


def change(after: Float[np.ndarray, "seeds n"], before: Float[np.ndarray, " n"]) -> str:
    """Mean change of windows' errors in per cent, and its standard error.

    Neighbouring windows share frames. So the error counts the spread between `BLOCKS` blocks of time, and
    that between the seeds.
    """
    off = after - before[None]
    blocks = np.asarray([block.mean() for block in np.array_split(off.mean(axis=0), BLOCKS)])
    square = standard_error(blocks) ** 2
    if len(off) > 1:
        square += standard_error(off.mean(axis=1)) ** 2
    return f"{100 * np.expm1(off.mean()):+.1f} ± {100 * np.exp(off.mean()) * np.sqrt(square):.1f}"


def tables(held: Held, trained: dict[str, list[Training]]) -> None:
    """Print a table for each tracker: errors before, and their changes by each training."""
    shipped = load_weights()
    for tracker in TRACKERS:
        before = held.errors(shipped, tracker)
        after = {
            loss: [held.errors(training.network, tracker) for training in trainings]
            for loss, trainings in trained.items()
        }
        rows = []
        for name in held.windows:
            cells = [
                change(np.stack([found[name] for found in per_seed]), before[name])
                for per_seed in after.values()
            ]
            error = 1e3 * np.exp(before[name].mean())
            rows.append((name, str(len(before[name])), f"{error:.2f}", *cells))
        columns = ("", "windows", "before mm", *(f"after, by {loss} %" for loss in after))
        print_table(f"Error of held-out tracked poses, {tracker}", columns, rows)


def plot(trained: dict[str, list[Training]], path: Path) -> None:
    """Losses over the steps, smoothed, a line a seed."""
    figure = Figure(figsize=(8, 2.8), layout="constrained")
    for axes, (name, trainings) in zip(figure.subplots(1, len(trained)), trained.items(), strict=True):
        for training in trainings:
            width = min(25, len(training.losses))
            mean = np.convolve(training.losses, np.full(width, 1 / width), "valid")
            axes.plot(np.arange(width, width + len(mean)), mean, linewidth=1)
        axes.set(title=f"training by {name}", xlabel="step", ylabel="mean logarithm of the error")
    figure.savefig(path)


def main() -> None:
    """Train, print the tables and draw the plot."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--windows", type=int, default=24, help="to train on, of each place or recording")
    parser.add_argument("--held-out", type=int, default=48, help="windows to judge by, of each place")
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--recordings", nargs="*", default=["redkitchen", "fr1_rpy"])
    parser.add_argument("--plot", type=Path, default=Path("learn_through_slam.svg"))
    arguments = parser.parse_args()
    trained: dict[str, list[Training]] = {}
    for seed in range(arguments.seeds):
        windows = [w for name in TRAINING for w in windows_of(name, seed, arguments.windows)]
        for name in arguments.recordings:
            windows += windows_of(name, seed, arguments.windows, TRAINING_PART)
        for name, loss in LOSSES.items():
            training = train(loss, windows, seed, steps=arguments.steps)
            trained.setdefault(name, []).append(training)
    tables(held_out(arguments.recordings, arguments.held_out), trained)
    plot(trained, arguments.plot)


if __name__ == "__main__":
    main()
