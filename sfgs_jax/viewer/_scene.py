"""The scene in the browser: the map, the path with its keyframes, and controls."""

import threading

import numpy as np
import viser

from sfgs_jax.geometry import Trajectory, quaternions_from_rotations
from sfgs_jax.viewer._splats import Splats

# Trajectories don't hold intrinsics, so frusta have the field of view of a common RGB-D camera.
_FIELD_OF_VIEW = np.radians(48)
_ASPECT = 4 / 3

_PATH_COLOUR, _KEYFRAME_COLOUR, _REPLAY_COLOUR = (37, 99, 235), (15, 23, 42), (220, 38, 38)

_REPLAY_FRAMES_PER_S = 20


class MapScene:
    """A map and a path in a viser server's scene.

    Args:
        server: the viser server; `close` stops it.
        splats: the map.
        trajectory: the path; may be empty.
        keyframes: poses to mark; may be empty.

    Attributes:
        server: the viser server.
        splats: the map's scene node, `/map`.
        path: the path's line, `/trajectory/path`; None without a trajectory.
        frusta: a camera frustum per keyframe, `/trajectory/keyframes/I`.
        replay: the frustum of the replayed frame, `/replay`; None without a trajectory.
    """

    def __init__(
        self, server: viser.ViserServer, splats: Splats, trajectory: Trajectory, keyframes: Trajectory
    ) -> None:
        self.server = server
        self._splats = splats
        self._trajectory = trajectory
        self._closed = threading.Event()
        self._player: threading.Thread | None = None
        # Recordings start about level, and the world is the first camera's: y points down.
        server.scene.set_up_direction("-y")
        self.splats = server.scene.add_gaussian_splats(
            "/map", splats.centres, splats.covariances, splats.rgb, splats.opacities
        )
        self.path: viser.SceneNodeHandle | None = None
        self.replay: viser.CameraFrustumHandle | None = None
        self.frusta: list[viser.CameraFrustumHandle] = []
        self._map_controls()
        if len(trajectory):
            self._add_trajectory(keyframes)
            self._replay_controls()
        self._place_viewer()

    def close(self) -> None:
        """Stop the replay and the server."""
        self._closed.set()
        if self._player is not None:
            self._player.join()
        self.server.stop()

    def show_map(self, *, size: float, least_opacity: float) -> None:
        """Draw the Gaussians in another size, and hide transparent ones.

        Args:
            size: factor on the standard deviations.
            least_opacity: Gaussians below this opacity are hidden.
        """
        opacities = self._splats.opacities
        self.splats.set_gaussians(
            self._splats.centres,
            self._splats.covariances * np.float32(size**2),
            self._splats.rgb,
            np.where(opacities >= least_opacity, opacities, 0),
        )

    def show_frame(self, index: int, *, follow: bool) -> None:
        """Put the replay's camera at a pose of the trajectory.

        Args:
            index: position in the trajectory.
            follow: take every browser's camera there too.
        """
        if self.replay is None:
            return
        pose = self._trajectory.poses[index]
        wxyz, position = quaternions_from_rotations(pose[None, :3, :3])[0], pose[:3, 3]
        self.replay.wxyz, self.replay.position = wxyz, position
        if follow:
            for client in self.server.get_clients().values():
                with client.atomic():
                    client.camera.wxyz, client.camera.position = wxyz, position

    def _add_trajectory(self, keyframes: Trajectory) -> None:
        scene, positions = self.server.scene, self._trajectory.positions
        extent = float(np.linalg.norm(np.ptp(positions, axis=0)))
        size = float(np.clip(0.02 * extent, 0.01, 0.15))
        if len(positions) > 1:
            segments = np.stack([positions[:-1], positions[1:]], axis=1)
            self.path = scene.add_line_segments(
                "/trajectory/path",
                segments.astype(np.float32),
                _PATH_COLOUR,
                thickness=3.0,
                thickness_units="screen",
            )
        wxyz = quaternions_from_rotations(keyframes.poses[:, :3, :3])
        self.frusta = [
            scene.add_camera_frustum(
                f"/trajectory/keyframes/{i}",
                fov=_FIELD_OF_VIEW,
                aspect=_ASPECT,
                scale=size,
                thickness=1.0,
                thickness_units="screen",
                color=_KEYFRAME_COLOUR,
                wxyz=wxyz[i],
                position=keyframes.positions[i],
            )
            for i in range(len(keyframes))
        ]
        self.replay = scene.add_camera_frustum(
            "/replay",
            fov=_FIELD_OF_VIEW,
            aspect=_ASPECT,
            scale=2 * size,
            thickness=3.0,
            thickness_units="screen",
            color=_REPLAY_COLOUR,
        )
        self.show_frame(0, follow=False)

    def _map_controls(self) -> None:
        gui = self.server.gui
        with gui.add_folder("Map"):
            gui.add_markdown(f"{len(self._splats.centres):,} Gaussians")
            size = gui.add_slider("Size", min=0.1, max=2.0, step=0.05, initial_value=1.0)
            opacity = gui.add_slider("Least opacity", min=0.0, max=1.0, step=0.02, initial_value=0.0)

            def update(_: viser.GuiEvent) -> None:
                self.show_map(size=size.value, least_opacity=opacity.value)

            size.on_update(update)
            opacity.on_update(update)

    def _replay_controls(self) -> None:
        gui = self.server.gui
        with gui.add_folder("Trajectory"):
            show_path = gui.add_checkbox("Path", initial_value=True)
            show_frusta = gui.add_checkbox("Keyframes", initial_value=True)
        with gui.add_folder("Replay"):
            last = len(self._trajectory) - 1
            frame = gui.add_slider(
                "Frame", min=0, max=max(last, 1), step=1, initial_value=0, disabled=last < 1
            )
            play = gui.add_checkbox("Play", initial_value=False)
            follow = gui.add_checkbox("Look from there", initial_value=False)

        @show_path.on_update
        def _(_: viser.GuiEvent) -> None:
            if self.path is not None:
                self.path.visible = show_path.value

        @show_frusta.on_update
        def _(_: viser.GuiEvent) -> None:
            for frustum in self.frusta:
                frustum.visible = show_frusta.value

        def move(_: viser.GuiEvent) -> None:
            self.show_frame(min(frame.value, last), follow=follow.value)

        frame.on_update(move)
        follow.on_update(move)

        def run() -> None:
            while not self._closed.wait(1 / _REPLAY_FRAMES_PER_S):
                if play.value and last > 0:
                    frame.value = (frame.value + 1) % (last + 1)

        self._player = threading.Thread(target=run, name="replay", daemon=True)
        self._player.start()

    def _place_viewer(self) -> None:
        """Start new browsers a little behind the first camera, or in front of the map's middle."""
        start = self.server.initial_camera
        if len(self._trajectory):
            pose = self._trajectory.poses[0]
            position, forward = pose[:3, 3], pose[:3, 2]
            start.position = position - 0.8 * forward - 0.3 * pose[:3, 1]
            start.look_at = position + 1.5 * forward
        elif len(self._splats.centres):
            low, middle, high = np.percentile(self._splats.centres, [5, 50, 95], axis=0)
            start.position = middle - np.array([0.0, 0.0, 1.5 * np.linalg.norm(high - low)])
            start.look_at = middle
