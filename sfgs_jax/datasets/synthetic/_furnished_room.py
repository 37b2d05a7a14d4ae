"""A furnished living room."""

import numpy as np

from sfgs_jax.datasets.synthetic._scene import Scene, SceneBuilder, inside_of_box

ROOM_SIZE = (5.4, 4.6, 2.6)
"""Metres along x, y, z; z points up, the floor is at z = 0, and the origin is in the middle of the floor."""


def furnished_room(seed: int) -> Scene:
    """A living room, free in the middle; the seed changes its colours, textures and where things stand."""
    rng = np.random.default_rng(seed)
    builder = SceneBuilder()
    _add_walls(builder)
    _add_sofa(builder, shift=rng.uniform(-0.2, 0.2))
    _add_shelf(builder, shift=rng.uniform(-0.2, 0.2))
    _add_table(builder, shift=rng.uniform(-0.2, 0.2))
    _add_cabinet(builder, shift=rng.uniform(-0.15, 0.15))
    _add_corners(builder)
    _add_pictures(builder)
    return builder.build(rng)


def _add_walls(builder: SceneBuilder) -> None:
    x, y, z = (ROOM_SIZE[0] / 2, ROOM_SIZE[1] / 2, ROOM_SIZE[2])
    sides = {(0, -1): "wall_x", (0, 1): "wall_x", (1, -1): "wall_y", (1, 1): "wall_y", (2, -1): "floor"}
    for corners in inside_of_box(ROOM_SIZE) + np.asarray((0, 0, z / 2)):
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        axis = int(np.argmax(np.abs(normal)))
        look = sides.get((axis, -int(np.sign(normal[axis]))), "ceiling")
        builder.faces(look, corners[None])
    # Skirting boards and a rug.
    builder.box("wood", (-x, y - 0.03, 0), (x, y, 0.1))
    builder.box("wood", (-x, -y, 0), (x, -y + 0.03, 0.1))
    builder.box("rug", (-1.1, -0.8, 0), (1.1, 0.8, 0.012))


def _add_sofa(builder: SceneBuilder, shift: float) -> None:
    x, y = ROOM_SIZE[0] / 2, shift
    builder.box("fabric", (x - 0.95, y - 0.95, 0), (x, y + 0.95, 0.42))
    builder.box("fabric", (x - 0.28, y - 0.95, 0.42), (x, y + 0.95, 0.85))
    builder.box("fabric", (x - 0.95, y - 1.15, 0), (x, y - 0.95, 0.62))
    builder.box("fabric", (x - 0.95, y + 0.95, 0), (x, y + 1.15, 0.62))
    builder.box("cushion", (x - 0.45, y - 0.75, 0.42), (x - 0.28, y - 0.35, 0.78))
    builder.box("mosaic", (x - 0.42, y + 0.25, 0.42), (x - 0.28, y + 0.65, 0.76))


def _add_shelf(builder: SceneBuilder, shift: float) -> None:
    y, left, right = ROOM_SIZE[1] / 2, -1.5 + shift, -0.1 + shift
    for side in (left, right - 0.04):
        builder.box("wood", (side, y - 0.34, 0), (side + 0.04, y, 1.95))
    for level in range(5):
        z = 0.08 + 0.46 * level
        builder.box("wood", (left, y - 0.34, z), (right, y, z + 0.03))
        if level < 4:
            end = (right - 0.08, right - 0.45, right - 0.2, right - 0.6)[level]
            builder.box(
                "books_x", (left + 0.05, y - 0.28, z + 0.03), (end, y - 0.02, z + 0.32 - 0.03 * (level % 2))
            )
    builder.sphere("ceramic", (right - 0.28, y - 0.17, 0.54 + 0.03 + 0.13), 0.13)
    builder.cylinder("ceramic", (right - 0.3, y - 0.17, 1.46 + 0.03), 0.09, 0.26)


def _add_table(builder: SceneBuilder, shift: float) -> None:
    x, y = 0.3 + shift, -ROOM_SIZE[1] / 2 + 0.5
    builder.box("pale_wood", (x - 0.8, y - 0.4, 0.70), (x + 0.8, y + 0.4, 0.74))
    for dx in (-0.75, 0.69):
        for dy in (-0.36, 0.30):
            builder.box("pale_wood", (x + dx, y + dy, 0), (x + dx + 0.06, y + dy + 0.06, 0.70))
    builder.cylinder("ceramic", (x - 0.45, y, 0.74), 0.1, 0.32)
    builder.sphere("ball", (x + 0.1, y + 0.1, 0.74 + 0.14), 0.14)
    builder.box("books_y", (x + 0.4, y - 0.2, 0.74), (x + 0.62, y + 0.15, 0.86))
    builder.box("screen", (x - 0.25, y - 0.34, 0.86), (x + 0.35, y - 0.30, 1.22))


def _add_cabinet(builder: SceneBuilder, shift: float) -> None:
    x, y = -ROOM_SIZE[0] / 2, -0.3 + shift
    builder.box("pale_wood", (x, y - 0.9, 0), (x + 0.45, y + 0.9, 0.55))
    builder.box("screen", (x + 0.12, y - 0.6, 0.65), (x + 0.18, y + 0.6, 1.35))
    builder.box("wood", (x + 0.08, y - 0.2, 0.55), (x + 0.28, y + 0.2, 0.65))
    builder.sphere("leaves", (x + 0.25, y + 0.75, 0.55 + 0.2), 0.2)


def _add_corners(builder: SceneBuilder) -> None:
    x, y = ROOM_SIZE[0] / 2, ROOM_SIZE[1] / 2
    builder.cylinder("mosaic", (-x + 0.4, y - 0.4, 0), 0.2, 0.45)
    builder.sphere("leaves", (-x + 0.4, y - 0.4, 0.85), 0.38)
    builder.cylinder("wood", (x - 0.35, y - 0.35, 0), 0.04, 1.5)
    builder.cylinder("cushion", (x - 0.35, y - 0.35, 1.35), 0.2, 0.3)
    builder.box("mosaic", (-x + 0.1, -y + 0.1, 0), (-x + 0.6, -y + 0.6, 0.9))
    builder.box("fabric", (x - 0.6, -y + 0.1, 0), (x - 0.1, -y + 0.6, 0.5))


def _add_pictures(builder: SceneBuilder) -> None:
    x, y = ROOM_SIZE[0] / 2, ROOM_SIZE[1] / 2
    builder.box("poster", (x - 0.03, -0.9, 1.2), (x, 0.1, 1.9))
    builder.box("mosaic", (x - 0.03, 0.5, 1.25), (x, 1.1, 1.95))
    builder.box("poster", (0.6, y - 0.03, 0.9), (1.5, y, 1.8))
    builder.box("mosaic", (-1.6, -y, 1.1), (-0.8, -y + 0.03, 1.8))
    builder.box("poster", (1.0, -y, 1.2), (1.8, -y + 0.03, 1.9))
    builder.box("poster", (-x, 0.9, 1.1), (-x + 0.03, 1.6, 1.9))
