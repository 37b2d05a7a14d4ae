"""Places that are hard for a SLAM system, each with a way through it."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from sfgs_jax.datasets.synthetic._building import Building, add_building, walk
from sfgs_jax.datasets.synthetic._furnished_room import furnished_room
from sfgs_jax.datasets.synthetic._path import along, closed_path, looking
from sfgs_jax.datasets.synthetic._scene import Scene, SceneBuilder, Triple

_HEIGHT = 2.6
"""Height of rooms, metres."""
_EYE = 1.4
"""Height of the camera, metres."""
_DESK = 0.75
"""Height of the desk, metres."""

_THINGS = ("wood", "pale_wood", "fabric", "mosaic", "poster", "books_x", "ceramic", "cushion", "leaves")


class Place(NamedTuple):
    """A scene, and the `T_world_cam` of the camera that walks through it.

    Attributes:
        scene: all of it.
        poses: of the camera.
        part: the part that is seen from a position in metres; always the whole if not given.
    """

    scene: Scene
    poses: Float[np.ndarray, "n 4 4"]
    part: Callable[[Float[np.ndarray, "3"]], Scene] | None = None


def _room(seed: int, num_frames: int) -> Place:
    return Place(furnished_room(seed), closed_path(num_frames))


def _ring(seed: int, num_frames: int) -> Place:
    """A corridor around a square block, 32 m in all, walked once and a little more."""
    rng = np.random.default_rng(seed)
    builder = SceneBuilder()
    _hall(builder, (-5, -5, 0), (5, 5, _HEIGHT))
    builder.box("wall_y", (-3, -3, 0), (3, 3, _HEIGHT))
    for side in range(4):
        turn = np.asarray([[0, -1], [1, 0]]) if side % 2 else np.eye(2)
        sign = 1 if side < 2 else -1
        for x in np.arange(-4.4, 4.5, 0.8):
            # Things along both walls, which leave the middle free.
            for inner, y in ((False, 5.0), (True, 3.0)):
                if inner and abs(x) > 2.6:
                    continue
                place = sign * turn @ np.asarray([x + rng.uniform(-0.2, 0.2), y])
                _thing(builder, rng, place, sign * turn @ np.asarray([0.0, 1.0 if inner else -1.0]))
    corners = np.asarray([(0, -4), (4, -4), (4, 4), (-4, 4), (-4, -4), (2, -4)], float)
    position, yaw = along(corners, num_frames, radius=0.7)
    return Place(builder.build(rng), _walked(position, yaw, num_frames))


def _twins(seed: int, num_frames: int) -> Place:
    """Two rooms that look the same, joined by a corridor; the camera looks all around in each."""
    rng = np.random.default_rng(seed)
    builder = SceneBuilder()
    things = rng.integers(2**31)
    for x in (-6.0, 6.0):
        builder.origin = (x, 0.0, 0.0)
        _cell(builder, np.random.default_rng(things))
    builder.origin = (0.0, 0.0, 0.0)
    _corridor(builder, rng)
    # A circle in each room, left and entered where its tangent is the way to the other room.
    third = num_frames // 3
    circle = np.linspace(-np.pi / 2, 3 * np.pi / 2, third)
    around = 0.5 * np.stack([np.cos(circle), np.sin(circle)], axis=1)
    corners = np.asarray([(-6, -0.5), (-5.2, -0.5), (-4, 0), (4, 0), (5.2, -0.5), (6, -0.5)])
    way, yaw = along(corners, num_frames - 2 * third + 2, radius=0.5)
    apart = np.asarray([6.0, 0.0])
    position = np.concatenate([around - apart, way[1:-1], around + apart])
    heading = np.concatenate([circle + np.pi / 2, yaw[1:-1] + 2 * np.pi, circle + np.pi / 2])
    return Place(builder.build(rng), _walked(position, heading, num_frames))


def _wall(seed: int, num_frames: int) -> Place:
    """A bare wall: the camera starts beside furniture, sees only the wall for a while, and comes back."""
    rng = np.random.default_rng(seed)
    builder = SceneBuilder()
    builder.box("bare", (-12, 0, -8), (12, 0.1, 8))
    for x in np.arange(-4.5, -1.5, 0.5):
        for z in (0.3, 1.1, 1.9):
            _thing(builder, rng, np.asarray([x, 0.0]), np.asarray([0.0, -1.0]), low=z)
    phase = np.linspace(0, 2 * np.pi, num_frames)
    x = -2.8 + 1.9 * (1 - np.cos(phase))
    position = np.stack([x, np.full(num_frames, -1.6), _EYE + 0.05 * np.sin(3 * phase)], axis=1)
    yaw = np.pi / 2 + 0.05 * np.sin(5 * phase)
    return Place(builder.build(rng), looking(position, yaw, 0.03 * np.sin(4 * phase), np.zeros(num_frames)))


def _sphere(seed: int, num_frames: int) -> Place:
    """A bare sphere in a hall; the camera goes half around it and back, closest half way."""
    rng = np.random.default_rng(seed)
    # Below the lamps' reach, since their light would show the triangles.
    depth = -20.0
    builder = SceneBuilder(origin=(0.0, 0.0, depth))
    builder.sphere("bare", (0, 0, _EYE), 1.0, subdivisions=3)
    _hall(builder, (-6, -6, 0), (6, 6, 4))
    for angle in np.linspace(0, 2 * np.pi, 12, endpoint=False):
        _thing(
            builder,
            rng,
            4 * np.asarray([np.cos(angle), np.sin(angle)]),
            -np.asarray([np.cos(angle), np.sin(angle)]),
        )
    phase = np.linspace(0, 2 * np.pi, num_frames)
    angle = np.pi / 2 * (1 - np.cos(phase))
    distance = 2.4 - 0.7 * np.sin(phase / 2) ** 2
    position = np.stack(
        [distance * np.cos(angle), distance * np.sin(angle), np.full(num_frames, depth + _EYE)], axis=1
    )
    return Place(builder.build(rng), looking(position, angle + np.pi, -0.05 + 0 * phase, 0 * phase))


def _desk(seed: int, num_frames: int) -> Place:
    """Small things on a desk with two panels; the camera goes to and fro before it, half a metre away."""
    rng = np.random.default_rng(seed)
    builder = SceneBuilder()
    builder.box("wood", (-0.6, -0.4, _DESK - 0.04), (0.6, 0.4, _DESK))
    builder.box("poster", (-0.6, 0.4, _DESK), (0.6, 0.42, _DESK + 0.8))
    builder.box("mosaic", (0.6, -0.4, _DESK), (0.62, 0.42, _DESK + 0.8))
    for x in np.linspace(-0.45, 0.45, 4):
        for y in np.linspace(-0.2, 0.25, 3):
            look, size = str(rng.choice(_THINGS)), rng.uniform(0.02, 0.05)
            centre = np.asarray([x, y]) + rng.uniform(-0.04, 0.04, 2)
            top = _point(centre + size, _DESK + rng.uniform(0.03, 0.25))
            builder.box(look, _point(centre - size, _DESK), top)
    seconds = np.arange(num_frames) / 30
    angle = -np.pi / 2 + np.sin(2 * np.pi * seconds / 7)
    distance = 0.55 + 0.1 * np.sin(2 * np.pi * seconds / 11)
    height = 0.4 + 0.12 * np.sin(2 * np.pi * seconds / 5)
    position = np.stack([distance * np.cos(angle), distance * np.sin(angle), _DESK + height], axis=1)
    pitch = -np.arctan2(height - 0.1, distance)
    return Place(builder.build(rng), looking(position, angle + np.pi, pitch, np.zeros(num_frames)))


def _building(seed: int, num_frames: int) -> Place:
    """Thirty rooms and the corridors between them; the camera sees no further than the next room."""
    rng = np.random.default_rng(seed)
    builder = SceneBuilder()
    cells = add_building(builder, rng)
    scene = builder.build(rng)
    position, yaw = walk(num_frames)
    return Place(scene, _walked(position, yaw, num_frames), Building(scene, cells).part)


PLACES: dict[str, Callable[[int, int], Place]] = {
    "room": _room,
    "ring": _ring,
    "twins": _twins,
    "wall": _wall,
    "sphere": _sphere,
    "desk": _desk,
    "building": _building,
}
"""Makes a place from a seed and a number of frames."""


def _walked(
    position: Float[np.ndarray, "n 2"], yaw: Float[np.ndarray, " n"], num_frames: int
) -> Float[np.ndarray, "n 4 4"]:
    """Poses at eye height that sway as a walker does, looking a little down."""
    beat = np.arange(num_frames) / 30 * 2 * np.pi
    height = _EYE + 0.03 * np.sin(1.1 * beat)
    sway, nod = np.deg2rad(12) * np.sin(0.23 * beat), np.deg2rad(-8) + np.deg2rad(4) * np.sin(0.31 * beat)
    eye = np.concatenate([position, height[:, None]], axis=1)
    return looking(eye, yaw + sway, nod, np.deg2rad(2) * np.sin(0.4 * beat))


def _thing(
    builder: SceneBuilder,
    rng: np.random.Generator,
    wall: Float[np.ndarray, "2"],
    inwards: Float[np.ndarray, "2"],
    low: float = 0.0,
) -> None:
    """Add a box, a column, a ball or a picture at a place on a wall, whose normal points inwards."""
    look = str(rng.choice(_THINGS))
    size, height = rng.uniform(0.12, 0.22), rng.uniform(0.5, 1.7)
    centre = wall + inwards * size
    match rng.integers(4):
        case 0:
            builder.box(look, _point(centre - size, low), _point(centre + size, low + height))
        case 1:
            builder.cylinder(look, _point(centre, low), size, height)
        case 2:
            builder.sphere(look, _point(centre, low + height), size)
        case _:
            half = np.abs(inwards[::-1]) * 0.35 + np.abs(inwards) * 0.02
            builder.box("poster", _point(wall - half, low + 1.0), _point(wall + half, low + 1.7))


def _point(xy: Float[np.ndarray, "2"], z: float) -> Triple:
    return (float(xy[0]), float(xy[1]), z)


def _hall(builder: SceneBuilder, low: Triple, high: Triple) -> None:
    """Add floor, ceiling and walls of an empty hall, seen from inside."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    wall = 0.1
    builder.box("floor", (x0, y0, z0 - wall), (x1, y1, z0))
    builder.box("ceiling", (x0, y0, z1), (x1, y1, z1 + wall))
    builder.box("wall_x", (x0 - wall, y0, z0), (x0, y1, z1))
    builder.box("wall_x", (x1, y0, z0), (x1 + wall, y1, z1))
    builder.box("wall_y", (x0, y0 - wall, z0), (x1, y0, z1))
    builder.box("wall_y", (x0, y1, z0), (x1, y1 + wall, z1))


def _cell(builder: SceneBuilder, rng: np.random.Generator) -> None:
    """Add a room of 5 m by 5 m with a doorway in the middle of each wall across x."""
    builder.box("floor", (-2.5, -2.5, -0.1), (2.5, 2.5, 0))
    builder.box("ceiling", (-2.5, -2.5, _HEIGHT), (2.5, 2.5, _HEIGHT + 0.1))
    for y in (-1, 1):
        inner, outer = sorted((y * 2.5, y * 2.6))
        builder.box("wall_y", (-2.5, inner, 0), (2.5, outer, _HEIGHT))
        for x in np.arange(-2.0, 2.1, 0.8):
            _thing(builder, rng, np.asarray([x, y * 2.5]), np.asarray([0.0, -y]))
    for x in (-1, 1):
        inner, outer = sorted((x * 2.5, x * 2.6))
        builder.box("wall_x", (inner, -2.5, 0), (outer, -0.6, _HEIGHT))
        builder.box("wall_x", (inner, 0.6, 0), (outer, 2.5, _HEIGHT))
        builder.box("wall_x", (inner, -0.6, 2.1), (outer, 0.6, _HEIGHT))
        for y in (-1.8, -1.1, 1.1, 1.8):
            _thing(builder, rng, np.asarray([x * 2.5, y]), np.asarray([-x, 0.0]))


def _corridor(builder: SceneBuilder, rng: np.random.Generator) -> None:
    """Add a corridor between the two cells, and dead ends beyond them."""
    for low, high in ((-10.0, -8.5), (-3.5, 3.5), (8.5, 10.0)):
        builder.box("pale_wood", (low, -0.6, -0.1), (high, 0.6, 0))
        builder.box("ceiling", (low, -0.6, 2.1), (high, 0.6, 2.2))
        builder.box("wall_y", (low, 0.6, 0), (high, 0.7, 2.1))
        builder.box("fabric", (low, -0.7, 0), (high, -0.6, 2.1))
        for x in np.arange(low + 0.4, high - 0.3, 0.9):
            for y in (-0.6, 0.6):
                half = np.asarray([0.25, 0.02])
                builder.box(
                    str(rng.choice(_THINGS)),
                    _point(np.asarray([x, y]) - half, rng.uniform(0.8, 1.2)),
                    _point(np.asarray([x, y]) + half, rng.uniform(1.4, 1.9)),
                )
    for x in (-10.1, 10.0):
        builder.box("mosaic", (x, -0.6, 0), (x + 0.1, 0.6, 2.1))
