"""Scenes of textured triangles, and the builder that collects them."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.datasets.synthetic._textures import Materials, Waves, random_waves

if TYPE_CHECKING:
    import trimesh

Triple = tuple[float | int, float | int, float | int]
"""A point, an extent or a colour."""


class Scene(eqx.Module):
    """Triangles that are seen from their front (counter-clockwise) side, with a texture each.

    Attributes:
        triangles: corners in world coordinates, metres.
        material: index of each triangle's texture.
        origin: origin of each triangle's texture, metres. Copies of a thing that are to look the same have
            an origin each.
        materials: the textures.
        waves: the plane waves of the textures.
    """

    triangles: Float[Array, "t 3 3"]
    material: Int[Array, " t"]
    origin: Float[Array, "t 3"]
    materials: Materials
    waves: Waves


@dataclass(frozen=True)
class _Look:
    """One texture; see `Materials`."""

    dark: Triple
    light: Triple
    octaves: tuple[float | int, float | int, float | int, float | int] = (0.5, 0.6, 0.6, 0.5)
    contrast: float = 1.2
    cells: Triple = (0.0, 0.0, 0.0)
    gap: float = 0.0
    tint: float = 0.0


_GREY, _WHITE = (0.45, 0.45, 0.45), (1.0, 1.0, 1.0)

_LOOKS = {
    "floor": _Look((0.36, 0.24, 0.15), (0.62, 0.46, 0.30), cells=(1.4, 5.5, 0), gap=0.006, tint=0.12),
    "ceiling": _Look(
        (0.66, 0.65, 0.62), (0.86, 0.85, 0.82), (0.8, 0.6, 0.4, 0.2), 0.8, cells=(1.6, 1.6, 0), gap=0.012
    ),
    "wall_x": _Look((0.50, 0.56, 0.60), (0.80, 0.83, 0.80), cells=(0, 1.2, 0), gap=0.008, tint=0.15),
    "wall_y": _Look((0.62, 0.52, 0.42), (0.86, 0.79, 0.66), cells=(2.5, 0, 2.5), gap=0.006, tint=0.12),
    "wood": _Look((0.30, 0.17, 0.09), (0.58, 0.38, 0.22), (0.3, 0.5, 0.8, 0.6), 1.4),
    "pale_wood": _Look((0.55, 0.42, 0.28), (0.80, 0.68, 0.50), (0.3, 0.5, 0.8, 0.6), 1.2),
    "fabric": _Look((0.12, 0.24, 0.38), (0.34, 0.50, 0.62), (0.2, 0.5, 0.9, 0.6), 1.5),
    "cushion": _Look((0.70, 0.22, 0.12), (0.92, 0.68, 0.30), (0.2, 0.5, 1.0, 0.6), 2.0),
    "rug": _Look(
        (0.45, 0.10, 0.12),
        (0.85, 0.72, 0.52),
        (0.3, 0.8, 0.9, 0.3),
        2.2,
        cells=(3.2, 3.2, 0),
        gap=0.02,
        tint=0.35,
    ),
    "books_x": _Look(_GREY, _WHITE, (0, 0.3, 0.8, 0.6), 1.0, cells=(24, 0, 0), gap=0.003, tint=0.95),
    "books_y": _Look(_GREY, _WHITE, (0, 0.3, 0.8, 0.6), 1.0, cells=(0, 20, 0), gap=0.003, tint=0.95),
    "poster": _Look((0.10, 0.20, 0.35), (0.95, 0.80, 0.45), (0.2, 0.9, 0.9, 0.3), 2.5),
    "mosaic": _Look((0.5, 0.5, 0.5), _WHITE, (0.1, 0.4, 0.6, 0.3), 1.0, cells=(9, 9, 9), gap=0.004, tint=0.9),
    "screen": _Look((0.05, 0.08, 0.12), (0.25, 0.55, 0.65), (0.4, 0.9, 0.6, 0.2), 1.8),
    "ceramic": _Look((0.15, 0.35, 0.45), (0.90, 0.92, 0.88), (0, 0.3, 1.0, 0.5), 2.0),
    "leaves": _Look((0.06, 0.22, 0.08), (0.45, 0.65, 0.25), (0, 0.3, 1.0, 0.9), 2.0),
    "ball": _Look((0.75, 0.15, 0.15), (0.95, 0.92, 0.85), (0.2, 0.5, 1.0, 0.2), 2.5),
    "bare": _Look((0.72, 0.71, 0.68), (0.72, 0.71, 0.68)),
}


@dataclass
class SceneBuilder:
    """Collects triangles.

    Attributes:
        origin: origin of the things that are added next, and of their textures, metres.
    """

    origin: Triple = (0.0, 0.0, 0.0)
    _triangles: list[np.ndarray] = field(default_factory=list)
    _material: list[np.ndarray] = field(default_factory=list)
    _origin: list[np.ndarray] = field(default_factory=list)

    @property
    def num_triangles(self) -> int:
        """Triangles added so far."""
        return sum(len(triangles) for triangles in self._triangles)

    def faces(self, look: str, corners: Float[np.ndarray, "t 3 3"]) -> None:
        """Add triangles.

        Args:
            look: name of the texture.
            corners: corners relative to the builder's origin, metres, counter-clockwise from the front.
        """
        self._triangles.append(corners + np.asarray(self.origin))
        self._material.append(np.full(len(corners), list(_LOOKS).index(look)))
        self._origin.append(np.tile(np.asarray(self.origin, np.float64), (len(corners), 1)))

    def box(self, look: str, low: Triple, high: Triple) -> None:
        """Add a box.

        Args:
            look: name of the texture.
            low: corner with the least coordinates, metres.
            high: the opposite corner, metres.
        """
        import trimesh

        extents = np.subtract(high, low)
        centre = tuple((np.add(low, high) / 2).tolist())
        self._add(trimesh.creation.box(extents=extents), look, centre)

    def cylinder(self, look: str, foot: Triple, radius: float, height: float) -> None:
        """Add an upright cylinder.

        Args:
            look: name of the texture.
            foot: middle of its bottom, metres.
            radius: metres.
            height: metres.
        """
        import trimesh

        mesh = trimesh.creation.cylinder(radius=radius, height=height, sections=14)
        self._add(mesh, look, (foot[0], foot[1], foot[2] + height / 2))

    def sphere(self, look: str, centre: Triple, radius: float, subdivisions: int = 1) -> None:
        """Add a sphere.

        Args:
            look: name of the texture.
            centre: metres.
            radius: metres.
            subdivisions: the sphere has 20 * 4 ** subdivisions triangles.
        """
        import trimesh

        self._add(trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius), look, centre)

    def _add(self, mesh: "trimesh.Trimesh", look: str, centre: Triple) -> None:
        """Add a mesh, moved to a centre."""
        self.faces(look, np.asarray(mesh.triangles, np.float64) + np.asarray(centre))

    def build(self, rng: np.random.Generator) -> Scene:
        """The scene of everything that was added, with textures and colours that the generator varies."""
        return Scene(
            triangles=jnp.asarray(np.concatenate(self._triangles), jnp.float32),
            material=jnp.asarray(np.concatenate(self._material), jnp.int32),
            origin=jnp.asarray(np.concatenate(self._origin), jnp.float32),
            materials=_materials(rng),
            waves=random_waves(rng),
        )


def part_of(scene: Scene, chosen: Bool[np.ndarray, " t"], room: int) -> Scene:
    """Some of a scene's triangles, and as many without area as fill the arrays.

    Args:
        scene: the whole.
        chosen: triangles to keep.
        room: triangles of the result, at least as many as are chosen.
    """
    kept = np.flatnonzero(chosen)
    filled = np.pad(kept, (0, room - len(kept)))
    real = (np.arange(room) < len(kept))[:, None, None]
    return Scene(
        triangles=jnp.where(real, scene.triangles[filled], 0),
        material=scene.material[filled],
        origin=scene.origin[filled],
        materials=scene.materials,
        waves=scene.waves,
    )


def inside_of_box(extents: Triple) -> Float[np.ndarray, "12 3 3"]:
    """Triangles of a box around the origin, seen from inside; extents in metres."""
    import trimesh

    box = trimesh.creation.box(extents=extents)
    box.invert()
    return np.asarray(box.triangles, np.float64)


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
