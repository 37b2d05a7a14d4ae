"""All that stands in the browser's scene, and the cameras that look at it."""

import numpy as np
import viser
from jaxtyping import Float

from sfgs_jax.geometry import Camera, Trajectory, quaternions_from_rotations
from sfgs_jax.viewer._cameras import BrowserCameras
from sfgs_jax.viewer._cropping import Box, extent
from sfgs_jax.viewer._levelling import Level, find_level, level_axes
from sfgs_jax.viewer._map_layer import MapLayer
from sfgs_jax.viewer._path_layer import PathLayer, field_of_view
from sfgs_jax.viewer._splats import Splats

AS_RECORDED = np.array([0.0, -1.0, 0.0])
"""Up of a first camera that is held upright: its y points down."""

_GRID, _BOX_COLOUR = (100, 116, 139), (245, 158, 11)


class Stage:
    """Nodes of a map and a path.

    Args:
        server: the viser server.
        splats: the map.
        trajectory: the path; may be empty.
        keyframes: poses to mark; may be empty.
        camera: intrinsics of the recording; None if they are not known.
        covariances: of the path's poses; None if they are not known.
        max_gaussians: Gaussians that are sent.

    Attributes:
        level: the map's vertical; None where its planes do not tell it.
        axes: rows: right, forward and up, level where the map tells it.
        low: least coordinates of the map along the axes, metres.
        high: largest coordinates.
        map: the Gaussians.
        path: the path with its keyframes; None without a trajectory.
        cameras: of the browsers.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        splats: Splats,
        trajectory: Trajectory,
        keyframes: Trajectory,
        camera: Camera | None,
        covariances: Float[np.ndarray, "n 6 6"] | None,
        max_gaussians: int,
    ) -> None:
        self._server, self._trajectory = server, trajectory
        self.fov = field_of_view(camera)[0]
        self.level = find_level(splats, trajectory.poses)
        self._up = AS_RECORDED if self.level is None else self.level.up
        self.axes = level_axes(self._up, trajectory.poses)
        self.low, self.high = extent(splats.centres, self.axes)
        self.map = MapLayer(server.scene, splats, self.axes, keyframes, camera, max_gaussians)
        self.path: PathLayer | None = None
        if len(trajectory):
            self.path = PathLayer(server.scene, trajectory, keyframes, camera, covariances)
        self.cameras = BrowserCameras(server, self.make_way)
        self._floor = None if self.level is None else self._add_floor(self.level)
        self._box: viser.LineSegmentsHandle | None = None
        self.set_up(level=True)
        self._place_viewers(splats)

    def set_up(self, *, level: bool) -> None:
        """Choose which way is up: as the map's planes tell, if they do, or as the first camera was held."""
        self._up = self.level.up if level and self.level is not None else AS_RECORDED
        self._server.scene.set_up_direction(self._up)
        self._server.initial_camera.up = self._up
        self.cameras.turn_up(self._up)

    def look_from(self, T_world_cam: Float[np.ndarray, "4 4"], client: viser.ClientHandle | None) -> None:
        """Take a browser, or all of them for None, to a pose with the recording's field of view."""
        self.cameras.look_from(T_world_cam, self.fov, client)
        self.make_way()

    def let_go(self) -> None:
        """Let browsers look on their own again."""
        self.cameras.let_go(self._up)

    def make_way(self) -> None:
        """Hide the frusta that browsers look from."""
        if self.path is not None:
            self.path.make_way(self.cameras.positions)

    def show_floor(self, shown: bool) -> None:
        """Show or hide the grid on the floor."""
        if self._floor is not None:
            self._floor.visible = shown

    def show_box(self, box: Box | None) -> None:
        """Draw the edges of a box, or none."""
        if box is None:
            if self._box is not None:
                self._box.visible = False
            return
        if self._box is None:
            self._box = self._server.scene.add_line_segments(
                "/crop", box.edges().astype(np.float32), _BOX_COLOUR, thickness=2.0, thickness_units="screen"
            )
        self._box.points = box.edges().astype(np.float32)
        self._box.visible = True

    def _add_floor(self, level: Level) -> viser.GridHandle:
        """A grid with a line a metre, on the floor."""
        middle = self.axes.T @ np.array([*(self.low + self.high)[:2] / 2, level.floor])
        return self._server.scene.add_grid(
            "/floor",
            plane="xy",
            infinite_grid=True,
            cell_size=1.0,
            section_size=5.0,
            cell_color=_GRID,
            section_color=_GRID,
            fade_distance=20.0,
            wxyz=quaternions_from_rotations(self.axes.T[None])[0],
            position=middle,
            visible=False,
        )

    def _place_viewers(self, splats: Splats) -> None:
        """Start new browsers a little behind the first camera, or in front of the map's middle."""
        start = self._server.initial_camera
        if len(self._trajectory):
            pose = self._trajectory.poses[0]
            position, forward = pose[:3, 3], pose[:3, 2]
            start.position = position - 0.8 * forward + 0.3 * self._up
            start.look_at = position + 1.5 * forward
        elif len(splats):
            low, middle, high = np.percentile(splats.centres, [5, 50, 95], axis=0)
            start.position = middle - 1.5 * np.linalg.norm(high - low) * self.axes[1]
            start.look_at = middle
