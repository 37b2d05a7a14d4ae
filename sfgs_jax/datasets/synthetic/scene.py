"""A furnished room of textured triangles."""

from dataclasses import dataclass, field

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import trimesh
from jaxtyping import Array, Float, Int

from sfgs_jax.datasets.synthetic.textures import Materials, Waves, random_waves

ROOM_SIZE = (5.4, 4.6, 2.6)
"""Metres along x, y, z; z points up, the floor is at z = 0, and the origin is in the middle of the floor."""

_Triple = tuple[float | int, float | int, float | int]


class Scene(eqx.Module):
    """Triangles that are seen from their front (counter-clockwise) side, with a texture each.

    Attributes:
        triangles: (T, 3, 3) corners in world coordinates, metres.
        material: (T,) index of each triangle's texture.
        materials: the textures.
        waves: the plane waves of the textures.
    """

    triangles: Float[Array, "t 3 3"]
    material: Int[Array, " t"]
    materials: Materials
    waves: Waves


@dataclass(frozen=True)
class _Look:
    """One texture; see `Materials`."""

    dark: _Triple
    light: _Triple
    octaves: tuple[float | int, float | int, float | int, float | int] = (0.5, 0.6, 0.6, 0.5)
    contrast: float = 1.2
    cells: _Triple = (0.0, 0.0, 0.0)
    gap: float = 0.0
    tint: float = 0.0


_LOOKS = {
    "floor": _Look((0.36, 0.24, 0.15), (0.62, 0.46, 0.30), cells=(1.4, 5.5, 0), gap=0.006, tint=0.12),
    "ceiling": _Look((0.66, 0.65, 0.62), (0.86, 0.85, 0.82), (0.8, 0.6, 0.4, 0.2), 0.8, (1.6, 1.6, 0), 0.012),
    "wall_x": _Look((0.50, 0.56, 0.60), (0.80, 0.83, 0.80), cells=(0, 1.2, 0), gap=0.008, tint=0.15),
    "wall_y": _Look((0.62, 0.52, 0.42), (0.86, 0.79, 0.66), cells=(2.5, 0, 2.5), gap=0.006, tint=0.12),
    "wood": _Look((0.30, 0.17, 0.09), (0.58, 0.38, 0.22), (0.3, 0.5, 0.8, 0.6), 1.4),
    "pale_wood": _Look((0.55, 0.42, 0.28), (0.80, 0.68, 0.50), (0.3, 0.5, 0.8, 0.6), 1.2),
    "fabric": _Look((0.12, 0.24, 0.38), (0.34, 0.50, 0.62), (0.2, 0.5, 0.9, 0.6), 1.5),
    "cushion": _Look((0.70, 0.22, 0.12), (0.92, 0.68, 0.30), (0.2, 0.5, 1.0, 0.6), 2.0),
    "rug": _Look(
        (0.45, 0.10, 0.12), (0.85, 0.72, 0.52), (0.3, 0.8, 0.9, 0.3), 2.2, (3.2, 3.2, 0), 0.02, 0.35
    ),
    "books_x": _Look((0.45, 0.45, 0.45), (1.0, 1.0, 1.0), (0, 0.3, 0.8, 0.6), 1.0, (24, 0, 0), 0.003, 0.95),
    "books_y": _Look((0.45, 0.45, 0.45), (1.0, 1.0, 1.0), (0, 0.3, 0.8, 0.6), 1.0, (0, 20, 0), 0.003, 0.95),
    "poster": _Look((0.10, 0.20, 0.35), (0.95, 0.80, 0.45), (0.2, 0.9, 0.9, 0.3), 2.5),
    "mosaic": _Look((0.5, 0.5, 0.5), (1.0, 1.0, 1.0), (0.1, 0.4, 0.6, 0.3), 1.0, (9, 9, 9), 0.004, 0.9),
    "screen": _Look((0.05, 0.08, 0.12), (0.25, 0.55, 0.65), (0.4, 0.9, 0.6, 0.2), 1.8),
    "ceramic": _Look((0.15, 0.35, 0.45), (0.90, 0.92, 0.88), (0, 0.3, 1.0, 0.5), 2.0),
    "leaves": _Look((0.06, 0.22, 0.08), (0.45, 0.65, 0.25), (0, 0.3, 1.0, 0.9), 2.0),
    "ball": _Look((0.75, 0.15, 0.15), (0.95, 0.92, 0.85), (0.2, 0.5, 1.0, 0.2), 2.5),
}


@dataclass
class _Builder:
    """Collects triangles."""

    triangles: list[np.ndarray] = field(default_factory=list)
    material: list[np.ndarray] = field(default_factory=list)

    def add(self, mesh: trimesh.Trimesh, look: str, centre: _Triple) -> None:
        corners = np.asarray(mesh.triangles, np.float64) + np.asarray(centre)
        self.triangles.append(corners)
        self.material.append(np.full(len(corners), list(_LOOKS).index(look)))

    def box(self, look: str, low: _Triple, high: _Triple) -> None:
        extents = np.subtract(high, low)
        centre = tuple((np.add(low, high) / 2).tolist())
        self.add(trimesh.creation.box(extents=extents), look, centre)

    def cylinder(self, look: str, foot: _Triple, radius: float, height: float) -> None:
        mesh = trimesh.creation.cylinder(radius=radius, height=height, sections=14)
        self.add(mesh, look, (foot[0], foot[1], foot[2] + height / 2))

    def sphere(self, look: str, centre: _Triple, radius: float) -> None:
        self.add(trimesh.creation.icosphere(subdivisions=1, radius=radius), look, centre)


def furnished_room(seed: int) -> Scene:
    """A living room, free in the middle; the seed changes its colours, textures and where things stand."""
    rng = np.random.default_rng(seed)
    builder = _Builder()
    _add_walls(builder)
    _add_sofa(builder, shift=rng.uniform(-0.2, 0.2))
    _add_shelf(builder, shift=rng.uniform(-0.2, 0.2))
    _add_table(builder, shift=rng.uniform(-0.2, 0.2))
    _add_cabinet(builder, shift=rng.uniform(-0.15, 0.15))
    _add_corners(builder)
    _add_pictures(builder)
    return Scene(
        triangles=jnp.asarray(np.concatenate(builder.triangles), jnp.float32),
        material=jnp.asarray(np.concatenate(builder.material), jnp.int32),
        materials=_materials(rng),
        waves=random_waves(rng),
    )


def _materials(rng: np.random.Generator) -> Materials:
    looks = list(_LOOKS.values())
    colours = np.asarray([(look.dark, look.light) for look in looks])
    colours = np.clip(colours + rng.uniform(-0.05, 0.05, (len(looks), 1, 3)), 0.02, 1)

    def column(name: str) -> Array:
        return jnp.asarray([getattr(look, name) for look in looks], jnp.float32)

    return Materials(
        colours=jnp.asarray(colours, jnp.float32),
        octaves=column("octaves"),
        contrast=column("contrast"),
        cells=column("cells"),
        gap=column("gap"),
        tint=column("tint"),
    )


def _add_walls(builder: _Builder) -> None:
    x, y, z = (ROOM_SIZE[0] / 2, ROOM_SIZE[1] / 2, ROOM_SIZE[2])
    room = trimesh.creation.box(extents=ROOM_SIZE)
    room.invert()  # seen from inside
    sides = {(0, -1): "wall_x", (0, 1): "wall_x", (1, -1): "wall_y", (1, 1): "wall_y", (2, -1): "floor"}
    for corners in np.asarray(room.triangles) + np.asarray((0, 0, z / 2)):
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        axis = int(np.argmax(np.abs(normal)))
        look = sides.get((axis, -int(np.sign(normal[axis]))), "ceiling")
        builder.triangles.append(corners[None])
        builder.material.append(np.asarray([list(_LOOKS).index(look)]))
    # Skirting boards and a rug.
    builder.box("wood", (-x, y - 0.03, 0), (x, y, 0.1))
    builder.box("wood", (-x, -y, 0), (x, -y + 0.03, 0.1))
    builder.box("rug", (-1.1, -0.8, 0), (1.1, 0.8, 0.012))


def _add_sofa(builder: _Builder, shift: float) -> None:
    x, y = ROOM_SIZE[0] / 2, shift
    builder.box("fabric", (x - 0.95, y - 0.95, 0), (x, y + 0.95, 0.42))
    builder.box("fabric", (x - 0.28, y - 0.95, 0.42), (x, y + 0.95, 0.85))
    builder.box("fabric", (x - 0.95, y - 1.15, 0), (x, y - 0.95, 0.62))
    builder.box("fabric", (x - 0.95, y + 0.95, 0), (x, y + 1.15, 0.62))
    builder.box("cushion", (x - 0.45, y - 0.75, 0.42), (x - 0.28, y - 0.35, 0.78))
    builder.box("mosaic", (x - 0.42, y + 0.25, 0.42), (x - 0.28, y + 0.65, 0.76))


def _add_shelf(builder: _Builder, shift: float) -> None:
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


def _add_table(builder: _Builder, shift: float) -> None:
    x, y = 0.3 + shift, -ROOM_SIZE[1] / 2 + 0.5
    builder.box("pale_wood", (x - 0.8, y - 0.4, 0.70), (x + 0.8, y + 0.4, 0.74))
    for dx in (-0.75, 0.69):
        for dy in (-0.36, 0.30):
            builder.box("pale_wood", (x + dx, y + dy, 0), (x + dx + 0.06, y + dy + 0.06, 0.70))
    builder.cylinder("ceramic", (x - 0.45, y, 0.74), 0.1, 0.32)
    builder.sphere("ball", (x + 0.1, y + 0.1, 0.74 + 0.14), 0.14)
    builder.box("books_y", (x + 0.4, y - 0.2, 0.74), (x + 0.62, y + 0.15, 0.86))
    builder.box("screen", (x - 0.25, y - 0.34, 0.86), (x + 0.35, y - 0.30, 1.22))


def _add_cabinet(builder: _Builder, shift: float) -> None:
    x, y = -ROOM_SIZE[0] / 2, -0.3 + shift
    builder.box("pale_wood", (x, y - 0.9, 0), (x + 0.45, y + 0.9, 0.55))
    builder.box("screen", (x + 0.12, y - 0.6, 0.65), (x + 0.18, y + 0.6, 1.35))
    builder.box("wood", (x + 0.08, y - 0.2, 0.55), (x + 0.28, y + 0.2, 0.65))
    builder.sphere("leaves", (x + 0.25, y + 0.75, 0.55 + 0.2), 0.2)


def _add_corners(builder: _Builder) -> None:
    x, y = ROOM_SIZE[0] / 2, ROOM_SIZE[1] / 2
    builder.cylinder("mosaic", (-x + 0.4, y - 0.4, 0), 0.2, 0.45)
    builder.sphere("leaves", (-x + 0.4, y - 0.4, 0.85), 0.38)
    builder.cylinder("wood", (x - 0.35, y - 0.35, 0), 0.04, 1.5)
    builder.cylinder("cushion", (x - 0.35, y - 0.35, 1.35), 0.2, 0.3)
    builder.box("mosaic", (-x + 0.1, -y + 0.1, 0), (-x + 0.6, -y + 0.6, 0.9))
    builder.box("fabric", (x - 0.6, -y + 0.1, 0), (x - 0.1, -y + 0.6, 0.5))


def _add_pictures(builder: _Builder) -> None:
    x, y = ROOM_SIZE[0] / 2, ROOM_SIZE[1] / 2
    builder.box("poster", (x - 0.03, -0.9, 1.2), (x, 0.1, 1.9))
    builder.box("mosaic", (x - 0.03, 0.5, 1.25), (x, 1.1, 1.95))
    builder.box("poster", (0.6, y - 0.03, 0.9), (1.5, y, 1.8))
    builder.box("mosaic", (-1.6, -y, 1.1), (-0.8, -y + 0.03, 1.8))
    builder.box("poster", (1.0, -y, 1.2), (1.8, -y + 0.03, 1.9))
    builder.box("poster", (-x, 0.9, 1.1), (-x + 0.03, 1.6, 1.9))
