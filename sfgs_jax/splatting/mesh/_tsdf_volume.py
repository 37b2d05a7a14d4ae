"""Truncated signed distances to a surface, fused from depth images, in bricks that exist only near it.

Source: Curless and Levoy, A volumetric method for building complex models from range images, 1996; Nießner
et al., Real-time 3D reconstruction at scale using voxel hashing, 2013.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Float32, Int, Int64

from sfgs_jax.arrays import InputError
from sfgs_jax.geometry import Camera

SIDE = 16
"""Voxels along the side of a brick."""

_BATCH = 64
"""Bricks that are updated at once: their arrays stay in the cache."""

_EDGE_WEIGHT = 0.02
"""Weight of a pixel at an edge of depth; elsewhere it is the square of the cosine between ray and normal.
Voxels beside an outline are seen by pixels of the surface before them, so outlines would grow."""

Place = tuple[int, int, int]
"""Position of a brick among bricks."""


class Brick(NamedTuple):
    """Voxels of a cube.

    Attributes:
        distance: mean signed distance in units of the truncation, from -1 to 1; positive in front of the
            surface.
        weight: sum of the weights of the images that saw the voxel.
        rgb: mean colour of the surface near it.
        rgb_weight: sum of the weights of the images that gave a colour.
    """

    distance: Float32[np.ndarray, "16 16 16"]
    weight: Float32[np.ndarray, "16 16 16"]
    rgb: Float32[np.ndarray, "16 16 16 3"]
    rgb_weight: Float32[np.ndarray, "16 16 16"]


class TsdfVolume:
    """Signed distances to a surface in a grid of voxels, averaged over depth images.

    The grid consists of bricks of 16 x 16 x 16 voxels. Only bricks near a surface take memory, 98 kB each.
    The voxel (i, j, k) lies at (i, j, k) times the voxel's side, in world coordinates.

    Args:
        voxel: side of a voxel, metres.
        truncation: distance at which signed distances are cut off, metres; None for 4 voxels. Things thinner
            than that are seen from one side only.
        max_bytes: most memory for bricks. Those that found no room are counted by `num_dropped`.

    Attributes:
        voxel: side of a voxel, metres.
        truncation: distance at which signed distances are cut off, metres.
        bricks: bricks by their positions.

    Raises:
        InputError: a size is not positive, or there is no room for one brick.
    """

    def __init__(self, voxel: float, *, truncation: float | None = None, max_bytes: int = 1 << 30) -> None:
        truncation = 4 * voxel if truncation is None else truncation
        if not (0 < voxel < math.inf and 0 < truncation < math.inf):
            raise InputError(
                f"A voxel's side and the truncation must be above 0 m, not {voxel!r} and {truncation!r}."
            )
        self.voxel, self.truncation = voxel, truncation
        self.bricks: dict[Place, Brick] = {}
        self._room = max_bytes // BRICK_BYTES
        self._dropped: set[Place] = set()
        if self._room < 1:
            raise InputError(f"A brick takes {BRICK_BYTES} bytes, more than max_bytes, {max_bytes}.")

    @property
    def num_bytes(self) -> int:
        """Memory of the bricks."""
        return len(self.bricks) * BRICK_BYTES

    @property
    def num_dropped(self) -> int:
        """Number of bricks that found no room; 0 where the surface is whole."""
        return len(self._dropped)

    def integrate(
        self,
        depth: Float[np.ndarray, "H W"],
        rgb: Float[np.ndarray, "H W 3"],
        camera: Camera,
        T_world_cam: Float[np.ndarray, "4 4"],
    ) -> None:
        """Add an image.

        Between pixels of one surface inverse depth is interpolated. At edges the nearest pixel counts.

        Args:
            depth: metres along z, 0 where missing.
            rgb: colours in [0, 1].
            camera: intrinsics of the image.
            T_world_cam: pose of the camera.

        Raises:
            InputError: the images are not of the camera's size.
        """
        if depth.shape != camera.shape or rgb.shape != (*camera.shape, 3):
            raise InputError(
                f"Depth {depth.shape} and colour {rgb.shape} don't fit a camera of {camera.shape}."
            )
        image = _Image(depth, rgb, camera, T_world_cam, self.truncation)
        places = self._with_bricks(self._near_surface(image))
        for start in range(0, len(places), _BATCH):
            self._update(places[start : start + _BATCH], image)

    def _near_surface(self, image: "_Image") -> list[Place]:
        """Positions of the bricks within the truncation of what the image shows."""
        brick = SIDE * self.voxel
        points = image.points_along_rays(self.truncation, brick / 2)
        index = np.floor(points / brick).astype(np.int64)
        _, first = np.unique(packed_rows(index), return_index=True)
        return [(i, j, k) for i, j, k in index[first].tolist()]

    def _with_bricks(self, places: list[Place]) -> list[Place]:
        """The places that have a brick, new ones as far as there is room."""
        for place in places:
            if place in self.bricks:
                continue
            if len(self.bricks) < self._room:
                self.bricks[place] = _empty_brick()
            else:
                self._dropped.add(place)
        return [place for place in places if place in self.bricks]

    def _update(self, places: list[Place], image: "_Image") -> None:
        bricks = [self.bricks[place] for place in places]
        ahead, rgb, weight = image.at_voxels(np.asarray(places) * SIDE, self.voxel)
        distance = np.minimum(ahead / np.float32(self.truncation), 1)
        rgb_weight = np.where(distance < 1, weight, 0)
        for number, brick in enumerate(bricks):
            _average(brick.distance, brick.weight, distance[number], weight[number])
            _average(brick.rgb, brick.rgb_weight, rgb[number], rgb_weight[number])


def _empty_brick() -> Brick:
    shape = (SIDE, SIDE, SIDE)
    return Brick(*(np.zeros(tail, np.float32) for tail in (shape, shape, (*shape, 3), shape)))


BRICK_BYTES = sum(array.nbytes for array in _empty_brick())
"""Memory of a brick."""


def _average(
    mean: Float32[np.ndarray, "16 16 16 *c"],
    total: Float32[np.ndarray, "16 16 16"],
    value: Float32[np.ndarray, "16 16 16 *c"],
    weight: Float32[np.ndarray, "16 16 16"],
) -> None:
    """Take a value into the running means."""
    total += weight
    share = np.divide(weight, total, out=np.zeros_like(total), where=weight > 0)
    mean += (share if mean.ndim == 3 else share[..., None]) * (value - mean)


def packed_rows(rows: Int[np.ndarray, "n 3"]) -> Int64[np.ndarray, " n"]:
    """An integer for each row; equal rows have equal ones. Sorting them is faster than sorting rows."""
    low = rows.min(axis=0, initial=0)
    i, j, k = (rows - low).T
    _, rows_j, rows_k = (rows.max(axis=0, initial=0) - low + 1).tolist()
    return (i * rows_j + j) * rows_k + k


class _Image:
    """A depth image with colours, for look-ups at points of the world."""

    def __init__(
        self,
        depth: Float[np.ndarray, "H W"],
        rgb: Float[np.ndarray, "H W 3"],
        camera: Camera,
        T_world_cam: Float[np.ndarray, "4 4"],
        truncation: float,
    ) -> None:
        self._depth = np.where(np.isfinite(depth) & (depth > 0), depth, 0).astype(np.float32)
        self._rgb = np.asarray(rgb, np.float32)
        self._fx, self._fy = float(camera.fx), float(camera.fy)
        self._cx, self._cy = float(camera.cx), float(camera.cy)
        self._pose, self._truncation = np.asarray(T_world_cam, np.float64), truncation
        known = self._depth > 0
        # Inverse depth is affine in the pixel on a plane. At an edge it must not be interpolated.
        self._inverse = np.divide(1, self._depth, out=np.zeros_like(self._depth), where=known)
        window = np.ones((3, 3), np.uint8)
        spread = cv2.dilate(self._depth, window) - cv2.erode(self._depth, window)
        self._smooth = (known & (spread < truncation)).astype(np.float32)
        self._facing = self._cosines()

    def _cosines(self) -> Float32[np.ndarray, "H W"]:
        """Distance from the surface's tangent plane for each metre along z; 1 at edges.

        The plane n . x = 1 has the inverse depth n . ray, so n follows from the slopes of inverse depth.
        """
        slope_v, slope_u = np.gradient(self._inverse)
        height, width = self._inverse.shape
        column, row = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
        x, y = self._fx * slope_u, self._fy * slope_v
        z = self._inverse - slope_u * (column - self._cx) - slope_v * (row - self._cy)
        length = np.sqrt(x * x + y * y + z * z)
        plane = (self._smooth > 0) & (length > 0)
        return np.divide(self._inverse, length, out=np.ones_like(length), where=plane)

    def points_along_rays(self, reach: float, step: float) -> Float[np.ndarray, "n 3"]:
        """World points within `reach` of the surface along the rays, about `step` apart or less, metres."""
        farthest = float(self._depth.max())
        stride = max(1, int(step * min(self._fx, self._fy) / max(farthest + reach, 1e-9)))
        v, u = np.nonzero(self._depth[::stride, ::stride])
        depth = self._depth[::stride, ::stride][v, u].astype(np.float64)
        ray = np.stack(
            [(u * stride - self._cx) / self._fx, (v * stride - self._cy) / self._fy, np.ones(len(u))], axis=1
        )
        offsets = np.linspace(-reach, reach, 1 + max(2, math.ceil(2 * reach / step)))
        along = np.maximum(depth + offsets[:, None], 0)
        points = (along[..., None] * ray).reshape(-1, 3)
        return points @ self._pose[:3, :3].T + self._pose[:3, 3]

    def at_voxels(
        self, corners: Int[np.ndarray, "b 3"], voxel: float
    ) -> tuple[
        Float32[np.ndarray, "b 16 16 16"],
        Float32[np.ndarray, "b 16 16 16 3"],
        Float32[np.ndarray, "b 16 16 16"],
    ]:
        """Each voxel's distance in front of the surface, its colour, and its weight: 0 where not seen."""
        R_cam_world = self._pose[:3, :3].T
        # Coordinates in the camera are sums of three terms, one for each axis of the grid.
        at = [(corners[:, i, None] + np.arange(SIDE)) * voxel - self._pose[i, 3] for i in range(3)]
        x, y, z = (
            (
                (row[0] * at[0])[:, :, None, None]
                + (row[1] * at[1])[:, None, :, None]
                + (row[2] * at[2])[:, None, None, :]
            ).astype(np.float32)
            for row in R_cam_world
        )
        in_front = z > 1e-3
        safe = np.where(in_front, z, 1)
        u, v = self._fx * x / safe + self._cx, self._fy * y / safe + self._cy
        height, width = self._depth.shape
        inside = in_front & (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5)
        column, row = (
            np.where(inside, np.rint(u), 0).astype(np.int32),
            np.where(inside, np.rint(v), 0).astype(np.int32),
        )
        nearest = self._depth[row, column]
        smooth = self._between(self._smooth, u, v) > 0.999
        inverse = np.where(smooth, self._between(self._inverse, u, v), 1)
        depth = np.where(smooth, 1 / inverse, nearest)
        ahead = depth - z
        seen = inside & (nearest > 0) & (ahead > -self._truncation)
        facing = self._facing[row, column]
        weight = np.where(self._smooth[row, column] > 0, facing * facing, np.float32(_EDGE_WEIGHT))
        return facing * ahead, self._rgb[row, column], np.where(seen, weight, np.float32(0))

    @staticmethod
    def _between(
        image: Float32[np.ndarray, "H W"],
        u: Float32[np.ndarray, "b 16 16 16"],
        v: Float32[np.ndarray, "b 16 16 16"],
    ) -> Float32[np.ndarray, "b 16 16 16"]:
        """Bilinear interpolation, towards 0 beyond the image."""
        flat = (len(u) * SIDE, SIDE * SIDE)
        return np.asarray(
            cv2.remap(
                image, u.reshape(flat), v.reshape(flat), cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT
            ),
            np.float32,
        ).reshape(u.shape)
