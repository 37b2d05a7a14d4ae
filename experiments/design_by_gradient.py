"""Design by gradient: the camera looks next where its pose will be known best.

    python -m experiments.design_by_gradient [--seeds 3] [--starts 16] [--plot FILE]

A furnished room was scanned before. The camera stands somewhere and looks anywhere, and may move by 30 cm
and 30 degrees before its next view. The covariance that the view would give its pose is predicted from the
map and descended by gradient over the motion. Its rivals are standing still, random motions of the full size,
and the best of many random ones by the same prediction. The last takes as long.

Then the views are taken, with the noise of a Kinect, and registered to the true room by keypoints and
surface. The error of a pose is the root mean square displacement of points 2 m around the camera.
"""

import argparse
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Float
from matplotlib.figure import Figure

from experiments.error_cells import percent, standard_error, with_error
from experiments.flat_map import flat_gaussians, merged
from experiments.matching_tables import print_table
from experiments.view_information import REACH, KnownPlace, displacement, predicted_covariance
from sfgs_jax import datasets, slam, splatting
from sfgs_jax.datasets.synthetic import add_noise, looking, render_view
from sfgs_jax.geometry import Camera, Frame, se3

BUDGET = np.repeat([0.3, np.radians(30.0)], 3).astype(np.float32)
"""Largest motion before the next view, metres and radians along each axis of a unit vector."""
STEPS, FIRST_STEP = 10, 0.4
"""Steps of the descent, and the length of a step at first as a share of the budget."""
RANDOM_VIEWS = 3
OFF_TARGET = np.repeat([0.02, np.radians(1.5)], 3)
"""Standard deviations of the error with which a motion is carried out, per axis."""
PLANNING_WIDTH, WIDTH = 80, 160
"""Columns of predicted images and of views that are taken."""
STRATEGIES = ("stand still", "random motion", "best of random", "gradient")


class Room(NamedTuple):
    """A room, what is known about it, and the settings to draw that with."""

    recording: datasets.SyntheticRecording
    planning: Camera
    known: KnownPlace
    config: splatting.RenderConfig


def scanned(seed: int, views: int = 36, width: int = WIDTH, planning_width: int = PLANNING_WIDTH) -> Room:
    """A room and the map of a scan of it.

    Args:
        seed: of the room.
        views: of the scan, looking all around from the middle.
        width: columns of the views.
        planning_width: columns of predicted images.
    """
    recording = datasets.SyntheticRecording(width=width, height=width * 3 // 4, seed=seed)
    planning = recording.camera.downscaled(width // planning_width)
    params = slam.tracker_params(recording.camera, slam.TrackingConfig())
    parts, landmarks, counts = [], [], []
    turn = np.linspace(0, 2 * np.pi, views, endpoint=False)
    level = np.radians(25) * (np.arange(views) % 3 - 1)
    stand = np.stack([-0.4 * np.cos(turn), -0.4 * np.sin(turn), np.full(views, 1.35)], axis=1)
    for pose in looking(stand, turn, level, np.zeros(views)):
        small = render_view(recording.scene, planning, se3.from_matrix(pose))
        parts.append(flat_gaussians(np.asarray(small.rgb), np.asarray(small.depth), planning, pose))
        keypoints = slam.observe(params, _taken(recording, se3.from_matrix(pose), None)).keypoints
        measured = np.asarray(keypoints.measured)
        landmarks.append(np.asarray(keypoints.points)[measured] @ pose[:3, :3].T + pose[:3, 3])
        counts.append(measured.sum())
    points = jnp.asarray(np.concatenate(landmarks), jnp.float32)
    share = np.mean(counts) / _mean_in_view(points, planning)
    known = KnownPlace(merged(parts), points, jnp.float32(share), jnp.float32(width / planning_width))
    config = splatting.RenderConfig(pair_capacity=1 << 17)
    return Room(recording, planning, known, config)


def _mean_in_view(points: Float[Array, "N 3"], camera: Camera) -> float:
    """Mean number of landmarks within the image of a camera in the room's middle, looking all around."""
    turn = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    stand = np.tile([0.0, 0.0, 1.35], (8, 1))
    inside = 0
    for pose in looking(stand, turn, np.full(8, -0.2), np.zeros(8)):
        seen = (np.asarray(points) - pose[:3, 3]) @ pose[:3, :3]
        pixels = np.asarray(camera.project(jnp.asarray(seen, jnp.float32)))
        far = np.asarray([camera.width, camera.height])
        inside += np.sum((seen[:, 2] > 0.2) & np.all((pixels >= 0) & (pixels < far), axis=1))
    return float(inside) / len(turn)


def _taken(recording: datasets.SyntheticRecording, T: jaxlie.SE3, key: Array | None) -> Frame:
    """A frame from a pose, with noise if there is a key."""
    view = render_view(recording.scene, recording.camera, T)
    rgb, depth = (view.rgb, view.depth) if key is None else add_noise(key, view, recording.camera)
    return Frame(np.asarray(rgb), np.asarray(depth), 0.0)


def starts(seed: int, count: int) -> Float[np.ndarray, "n 4 4"]:
    """Poses near the room's middle that look anywhere, within 25 degrees of the horizon."""
    rng = np.random.default_rng(seed)
    position = np.concatenate([rng.uniform(-1, 1, (count, 2)), rng.uniform(1.0, 1.7, (count, 1))], axis=1)
    yaw, pitch = rng.uniform(0, 2 * np.pi, count), np.radians(rng.uniform(-25, 25, count))
    return looking(position, yaw, pitch, np.zeros(count))


def moved(start: jaxlie.SE3, motion: Float[Array | np.ndarray, "6"]) -> jaxlie.SE3:
    """The pose after a motion, given as shares of the budget."""
    return se3.compose(start, se3.exp(jnp.asarray(motion, jnp.float32) * BUDGET))


def within(motion: Float[np.ndarray, "6"]) -> Float[np.ndarray, "6"]:
    """The nearest motion within the budget: both of its parts have at most length 1."""
    parts = motion.reshape(2, 3)
    return (parts / np.maximum(np.linalg.norm(parts, axis=1, keepdims=True), 1)).reshape(6)


@partial(jax.jit, static_argnames="config")
def expected(
    known: KnownPlace,
    camera: Camera,
    start: jaxlie.SE3,
    motion: Float[Array, "6"],
    config: splatting.RenderConfig,
) -> Float[Array, ""]:
    """Logarithm of the error that is expected of a view after a motion."""
    return jnp.log(displacement(predicted_covariance(known, camera, moved(start, motion), config)))


@partial(jax.jit, static_argnames="config")
def expected_and_slope(
    known: KnownPlace,
    camera: Camera,
    start: jaxlie.SE3,
    motion: Float[Array, "6"],
    config: splatting.RenderConfig,
) -> tuple[Float[Array, ""], Float[Array, "6"]]:
    """The same with its gradient by the motion."""
    return jax.value_and_grad(expected, argnums=3)(known, camera, start, motion, config)


class Plan(NamedTuple):
    """Motions of each strategy, what is expected of the chosen ones, and the descent's course, in metres."""

    motions: dict[str, list[np.ndarray]]
    expected: dict[str, float]
    course: list[float]


def descent(room: Room, start: jaxlie.SE3, steps: int = STEPS) -> tuple[np.ndarray, list[float]]:
    """The motion with the least expected error on the way down, and the least error so far at each step.

    Args:
        room: where.
        start: the pose before.
        steps: along the gradient from the best motion so far; half as long after one that did not help.
    """
    best, course, reach = np.zeros(6, np.float32), [], FIRST_STEP
    slope, least = np.zeros(6), np.inf
    motion = best
    for _ in range(steps + 1):
        value, gradient = expected_and_slope(
            room.known, room.planning, start, jnp.asarray(motion), room.config
        )
        if float(value) < least:
            best, least = motion, float(value)
            slope = np.asarray(gradient) / max(float(jnp.linalg.norm(gradient)), 1e-9)
        else:
            reach /= 2
        course.append(float(np.exp(least)))
        motion = within(best - reach * slope).astype(np.float32)
    return best, course


def planned(room: Room, start: jaxlie.SE3, rng: np.random.Generator, steps: int = STEPS) -> Plan:
    """Motions of all strategies from a start."""
    draws = rng.normal(size=(3 * steps, 2, 3))
    draws = (draws / np.linalg.norm(draws, axis=2, keepdims=True)).reshape(-1, 6).astype(np.float32)

    def value(motion: np.ndarray) -> float:
        return float(jnp.exp(expected(room.known, room.planning, start, jnp.asarray(motion), room.config)))

    values = [value(motion) for motion in draws]
    best, course = descent(room, start, steps)
    still = np.zeros(6, np.float32)
    motions = {
        "stand still": [still],
        "random motion": list(draws[:RANDOM_VIEWS]),
        "best of random": [draws[int(np.argmin(values))]],
        "gradient": [best],
    }
    told = (value(still), float(np.mean(values)), min(values), course[-1])
    return Plan(motions, dict(zip(STRATEGIES, told, strict=True)), course)


class Outcome(NamedTuple):
    """A view's registration: its error and the deviation that it claims, metres, and whether it was found."""

    error: float
    claimed: float
    found: bool


def measured(
    room: Room, params: slam.TrackerParams, T: jaxlie.SE3, key: Array, off: Float[np.ndarray, "6"]
) -> Outcome:
    """Take a noisy view near a pose and register it to the room as it is seen from the pose.

    Args:
        room: where.
        params: of tracking.
        T: the pose that was aimed at.
        key: of the noise.
        off: error with which it was reached, a tangent.
    """
    reached = se3.exp(jnp.asarray(off, jnp.float32))
    target = slam.observe(params, _taken(room.recording, T, None))
    source = slam.observe(params, _taken(room.recording, se3.compose(T, reached), key))
    result = slam.register(params, source, target, se3.identity())
    error = np.asarray(se3.log(se3.compose(se3.inverse(reached), result.T_target_source)))
    covariance = jnp.linalg.inv(result.information + 1e-2 * jnp.eye(6))
    length = np.sqrt(np.sum(error[:3] ** 2) + 2 / 3 * REACH**2 * np.sum(error[3:] ** 2))
    return Outcome(float(length), float(displacement(covariance)), bool(result.found))


class Result(NamedTuple):
    """Figures of one room, and the courses of its descents.

    Attributes:
        squares: mean squares of the errors that are expected, claimed and measured, and the share of views
            that were lost, for each start and strategy; square metres.
        courses: expected errors of each start's descent, metres.
    """

    squares: Float[np.ndarray, "starts strategies 4"]
    courses: Float[np.ndarray, "starts steps"]


def one_room(room: Room, seed: int, count: int, repeats: int, steps: int = STEPS) -> Result:
    """Plan and take the views of one room.

    Args:
        room: the room.
        seed: of the starts and of the noise.
        count: starts.
        repeats: noisy views of each motion.
        steps: of the descent.
    """
    rng = np.random.default_rng(seed)
    params = slam.tracker_params(room.recording.camera, slam.TrackingConfig())
    squares, courses = np.zeros((count, len(STRATEGIES), 4)), []
    for number, pose in enumerate(starts(seed, count)):
        start = se3.from_matrix(pose)
        plan = planned(room, start, rng, steps)
        courses.append(plan.course)
        # All strategies meet the same noise and the same errors on the way.
        offs = OFF_TARGET * rng.normal(size=(repeats, 6))
        keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), number), repeats)
        for column, name in enumerate(STRATEGIES):
            outcomes = [
                measured(room, params, moved(start, motion), key, off)
                for motion in plan.motions[name]
                for key, off in zip(keys, offs, strict=True)
            ]
            squares[number, column] = _mean_squares(plan.expected[name], outcomes)
    return Result(squares, np.asarray(courses))


def _mean_squares(told: float, outcomes: list[Outcome]) -> Float[np.ndarray, "4"]:
    """Mean squares over the views that were found, and the share of those that were not."""
    found = [o for o in outcomes if o.found]
    lost = 1 - len(found) / len(outcomes)
    errors = ([o.claimed for o in found], [o.error for o in found])
    return np.asarray([told**2, *(np.mean(np.square(e)) for e in errors), lost])


def changes(results: list[Result], strategy: int) -> Float[np.ndarray, " n"]:
    """Logarithms of each start's measured error, as a share of that of standing still there."""
    return np.concatenate([np.log(r.squares[:, strategy, 2] / r.squares[:, 0, 2]) / 2 for r in results])


def plot(results: list[Result], path: Path) -> None:
    """Expected error over the descent, a line a start and a room; measured changes, a dot a start."""
    figure = Figure(figsize=(8, 3), layout="constrained")
    left, right = figure.subplots(1, 2)
    for result in results:
        left.plot(1e3 * result.courses.T, color="#94a3b8", linewidth=0.5)
        left.plot(1e3 * result.courses.mean(axis=0), linewidth=2)
    left.set(xlabel="step", ylabel="expected error, mm", ylim=(0, None))
    for place in range(len(STRATEGIES) - 1):
        values = changes(results, place + 1)
        spots = place + np.linspace(-0.2, 0.2, len(values))
        right.plot(spots, 100 * np.expm1(values), ".", color="#94a3b8", markersize=4)
        mean, error = np.expm1(values.mean()), standard_error(values)
        right.errorbar(place, 100 * mean, 100 * error, fmt="o")
    right.axhline(0, color="grey", linestyle=":", linewidth=1)
    right.set(xticks=range(len(STRATEGIES) - 1), ylabel="change of the measured error, %")
    right.set_xticklabels(STRATEGIES[1:])
    figure.savefig(path)


def table(results: list[Result]) -> list[tuple[str, ...]]:
    """A row for each strategy, with standard errors over the rooms.

    The last column compares the measured error with that of standing still. It is the geometric mean over all
    starts, with the standard error over these.
    """
    rows = []
    for i, name in enumerate(STRATEGIES):
        lengths = [1e3 * np.sqrt(r.squares[:, i, :3].mean(axis=0)) for r in results]
        lost = [100 * r.squares[:, i, 3].mean() for r in results]
        cells = [with_error(column) for column in np.transpose(lengths)]
        rows.append((name, *cells, with_error(np.asarray(lost)), percent(changes(results, i))))
    return rows


def main() -> None:
    """Print the table and draw the plot."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--starts", type=int, default=16)
    parser.add_argument("--repeats", type=int, default=6, help="noisy views of each motion")
    parser.add_argument("--plot", type=Path, default=Path("design_by_gradient.svg"))
    arguments = parser.parse_args()
    results = [
        one_room(scanned(seed), seed, arguments.starts, arguments.repeats) for seed in range(arguments.seeds)
    ]
    columns = ("next view", "expected mm", "claimed mm", "measured mm", "lost %", "measured, by start %")
    print_table("Error of the next view's pose: displacement of points 2 m away", columns, table(results))
    plot(results, arguments.plot)


if __name__ == "__main__":
    main()
