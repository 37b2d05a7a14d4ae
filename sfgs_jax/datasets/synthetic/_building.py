"""A building: thirty rooms in a grid, joined by corridors, and a walk through all of them."""

import numpy as np
from jaxtyping import Bool, Float, Int

from sfgs_jax.datasets.synthetic._path import along
from sfgs_jax.datasets.synthetic._scene import Scene, SceneBuilder, Triple, part_of

_COLUMNS, _ROWS = 6, 5
_PITCH = 7.0
"""Distance between the middles of neighbouring rooms, metres."""
_HALF = 2.5
"""Half the width of a room, metres."""
_DOOR = 0.6
"""Half the width of a doorway and of a corridor, metres."""
_LINTEL = 2.1
_HEIGHT = 2.6
_ROUND = 0.9
"""Radius of the way around the middle of a room, metres."""
_SHORTCUT = 2
"""Column of rooms that the way back leads through."""

_WALLS = ("wall_x", "wall_y", "fabric", "pale_wood", "mosaic", "rug", "wood")
_THINGS = ("wood", "pale_wood", "fabric", "mosaic", "poster", "books_x", "ceramic", "cushion", "leaves")

_Room = tuple[int, int]
"""Column and row of a room."""
_Span = tuple[float | int, float | int]
"""From and to, metres."""


def add_building(builder: SceneBuilder, rng: np.random.Generator) -> Int[np.ndarray, " t"]:
    """Add the rooms and corridors; the first room's middle is the origin.

    Args:
        builder: empty.
        rng: decides on walls and furniture, so that no two rooms look the same.

    Returns:
        The cell of each triangle: the number of the room that it is in, or that its corridor leads out of.
    """
    links, cells = _links(), []
    for number in range(_COLUMNS * _ROWS):
        room = number % _COLUMNS, number // _COLUMNS
        before = builder.num_triangles
        builder.origin = (*(_PITCH * np.asarray(room)).tolist(), 0.0)
        _add_room(builder, rng, {way for way in _WAYS if _linked(links, room, way)})
        for way in ((1, 0), (0, 1)):
            if _linked(links, room, way):
                _add_corridor(builder, rng, way)
        cells += [number] * (builder.num_triangles - before)
    builder.origin = (0.0, 0.0, 0.0)
    return np.asarray(cells)


class Building:
    """The parts of a building that a camera sees: its own room and those around it, which hide the others."""

    def __init__(self, scene: Scene, cells: Int[np.ndarray, " t"]):
        """Sort the triangles by where they are seen from.

        Args:
            scene: the whole.
            cells: (t,) from `add_building`.
        """
        self._scene = scene
        self._columns, self._rows = cells % _COLUMNS, cells // _COLUMNS
        near = [self._near(x, y).sum() for x in range(_COLUMNS) for y in range(_ROWS)]
        self._room = int(max(near))
        self._parts: dict[_Room, Scene] = {}

    def part(self, position: Float[np.ndarray, "3"]) -> Scene:
        """The part that is seen from a position in metres; all parts have equally many triangles."""
        column, row = np.rint(position[:2] / _PITCH).astype(int).tolist()
        if (column, row) not in self._parts:
            self._parts[column, row] = part_of(self._scene, self._near(column, row), self._room)
        return self._parts[column, row]

    def _near(self, column: int, row: int) -> Bool[np.ndarray, " t"]:
        return (np.abs(self._columns - column) <= 1) & (np.abs(self._rows - row) <= 1)


def walk(num_frames: int) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    """A walk through all rooms, once around in each, then by a shortcut back to the first and around it.

    Args:
        num_frames: positions, at equal steps along 450 m.

    Returns:
        Positions in metres, and the yaw of the direction of travel in radians.
    """
    rooms = [
        (x, y) for y in range(_ROWS) for x in (range(_COLUMNS) if y % 2 == 0 else reversed(range(_COLUMNS)))
    ]
    last = rooms[-1]
    back = [(x, last[1]) for x in range(last[0] - 1, _SHORTCUT - 1, -1)]
    back += [(_SHORTCUT, y) for y in range(last[1] - 1, -1, -1)]
    back += [(x, 0) for x in range(_SHORTCUT - 1, -1, -1)]
    corners = [np.asarray([-1.5, 0.0])]
    for i, room in enumerate(rooms + back):
        middle = _PITCH * np.asarray(room, float)
        ahead = (rooms + back)[min(i + 1, len(rooms + back) - 1)]
        came = corners[-1] - middle
        leaves = _PITCH / 2 * np.subtract(ahead, room) if ahead != room else came
        again = len(rooms) <= i < len(rooms) + len(back) - 1
        corners += [middle] if again else _around(middle, came, leaves)
        if i < len(rooms) + len(back) - 1:
            corners += [middle + leaves]
    return along(np.asarray(corners), num_frames, radius=0.5)


_WAYS: tuple[_Room, ...] = ((1, 0), (0, 1), (-1, 0), (0, -1))


def _links() -> set[frozenset[_Room]]:
    """Pairs of rooms that a corridor joins."""
    along_rows = {frozenset({(x, y), (x + 1, y)}) for x in range(_COLUMNS - 1) for y in range(_ROWS)}
    ends = {frozenset({(x, y), (x, y + 1)}) for y in range(_ROWS - 1) for x in [(_COLUMNS - 1) * (1 - y % 2)]}
    shortcut = {frozenset({(_SHORTCUT, y), (_SHORTCUT, y + 1)}) for y in range(_ROWS - 1)}
    return along_rows | ends | shortcut


def _linked(links: set[frozenset[_Room]], room: _Room, way: _Room) -> bool:
    return frozenset({room, (room[0] + way[0], room[1] + way[1])}) in links


def _around(
    middle: Float[np.ndarray, "2"], came: Float[np.ndarray, "2"], leaves: Float[np.ndarray, "2"]
) -> list[Float[np.ndarray, "2"]]:
    """Corners of a way once around the middle of a room, and on to where it is left."""
    start, end = np.arctan2(came[1], came[0]), np.arctan2(leaves[1], leaves[0])
    # In by the right, out by the right: the circle is met and left where it leads the way one goes.
    start, end = start + 0.8, end - 0.8
    turn = (end - start) % (2 * np.pi) + (2 * np.pi if (end - start) % (2 * np.pi) < 3.5 else 0.0)
    angles = start + np.linspace(0, turn, 16)
    return [middle + _ROUND * np.asarray([np.cos(angle), np.sin(angle)]) for angle in angles]


def _add_room(builder: SceneBuilder, rng: np.random.Generator, doors: set[_Room]) -> None:
    """Add floor, ceiling, four walls with doorways, and things along the walls."""
    builder.box(str(rng.choice(("floor", "wood", "rug"))), (-_HALF, -_HALF, -0.1), (_HALF, _HALF, 0))
    builder.box("ceiling", (-_HALF, -_HALF, _HEIGHT), (_HALF, _HALF, _HEIGHT + 0.1))
    for way in _WAYS:
        look = str(rng.choice(_WALLS))
        if way not in doors:
            _add_panel(builder, look, way, (-_HALF, _HALF), (0, _HEIGHT))
        else:
            _add_panel(builder, look, way, (-_HALF, -_DOOR), (0, _HEIGHT))
            _add_panel(builder, look, way, (_DOOR, _HALF), (0, _HEIGHT))
            _add_panel(builder, look, way, (-_DOOR, _DOOR), (_LINTEL, _HEIGHT))
        for place in (-2.1, -1.4, 1.4, 2.1) if way in doors else (-2.0, -1.2, -0.4, 0.4, 1.2, 2.0):
            _add_thing(builder, rng, way, place + rng.uniform(-0.15, 0.15))


def _add_panel(builder: SceneBuilder, look: str, way: _Room, across: _Span, height: _Span) -> None:
    """Add a piece of the wall on one side of a room, 10 cm thick."""
    _add_box(builder, look, way, (_HALF, _HALF + 0.1), across, height)


def _add_thing(builder: SceneBuilder, rng: np.random.Generator, way: _Room, across: float) -> None:
    """Add a box on the floor, or a picture, at a wall."""
    look, size = str(rng.choice(_THINGS)), rng.uniform(0.12, 0.3)
    if rng.integers(3):
        height, deep = rng.uniform(0.4, 1.8), rng.uniform(0.2, 0.5)
        _add_box(builder, look, way, (_HALF - deep, _HALF), (across - size, across + size), (0.0, height))
    else:
        low, high = rng.uniform(0.8, 1.2), rng.uniform(1.5, 2.0)
        sides = (across - size, across + size)
        _add_box(builder, "poster", way, (_HALF - 0.03, _HALF), sides, (low, high))


def _add_corridor(builder: SceneBuilder, rng: np.random.Generator, way: _Room) -> None:
    """Add the corridor that leads out of a room one way, with pictures along it."""
    long = (_HALF, _PITCH - _HALF)
    _add_box(builder, "pale_wood", way, long, (-_DOOR, _DOOR), (-0.1, 0))
    _add_box(builder, "ceiling", way, long, (-_DOOR, _DOOR), (_LINTEL, _LINTEL + 0.1))
    for side in (-1, 1):
        wall = sorted((side * _DOOR, side * (_DOOR + 0.1)))
        between = (long[0] + 0.1, long[1] - 0.1)
        _add_box(builder, str(rng.choice(_WALLS)), way, between, (wall[0], wall[1]), (0, _LINTEL))
        for at in (0.5, 1.3):
            start = _HALF + at + rng.uniform(-0.2, 0.0)
            picture = sorted((side * _DOOR, side * (_DOOR - 0.02)))
            low, high = rng.uniform(0.8, 1.2), rng.uniform(1.4, 1.9)
            look = str(rng.choice(_THINGS))
            _add_box(builder, look, way, (start, start + 0.5), (picture[0], picture[1]), (low, high))


def _add_box(
    builder: SceneBuilder,
    look: str,
    way: _Room,
    ahead: _Span,
    across: _Span,
    height: _Span,
) -> None:
    """Add a box by its extents along a way, across it, and upwards."""
    forward = np.asarray(way, float)
    left = np.asarray([-forward[1], forward[0]])
    ends = np.asarray([a * forward + b * left for a, b in zip(ahead, across, strict=True)])
    low, high = ends.min(axis=0), ends.max(axis=0)
    builder.box(look, _triple(low, height[0]), _triple(high, height[1]))


def _triple(xy: Float[np.ndarray, "2"], z: float | int) -> Triple:
    return (float(xy[0]), float(xy[1]), z)
