"""The page of a finished run: map, path, replay, and files to take away."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import viser
from jaxtyping import Float, UInt8

from sfgs_jax.arrays import InputError
from sfgs_jax.geometry import Camera, Trajectory
from sfgs_jax.splatting import Gaussians
from sfgs_jax.viewer._cameras import pose_of
from sfgs_jax.viewer._controls import MapControls, ReplayControls, SaveControls
from sfgs_jax.viewer._cropping import Box
from sfgs_jax.viewer._downloads import Downloads
from sfgs_jax.viewer._files import MapFiles
from sfgs_jax.viewer._finished_run import RecordedFrames
from sfgs_jax.viewer._frame_panel import FramePanel, view_camera
from sfgs_jax.viewer._latest import Latest
from sfgs_jax.viewer._modes import Look, Mode
from sfgs_jax.viewer._painting import Painter
from sfgs_jax.viewer._plain_text import plain_text
from sfgs_jax.viewer._replay import Replay
from sfgs_jax.viewer._server import Page
from sfgs_jax.viewer._server_rendering import Drawer, ServerRendering
from sfgs_jax.viewer._splats import Splats
from sfgs_jax.viewer._stage import Stage

MOST_GAUSSIANS = 300_000
"""Gaussians that a page draws at most; a larger map is drawn as a sample."""

_REST_S = 0.4
"""Time after the last event of a slider before the map is sent again."""


class MapScene(Page):
    """A map and a path in a viser server's scene, with controls.

    Args:
        server: the viser server; `close` stops it.
        splats: the map.
        trajectory: the path; may be empty.
        keyframes: poses to mark; may be empty.
        gaussians: the same map, for images, videos and files of it; None has none of them.
        camera: intrinsics of the recording; None takes the field of view of a common camera.
        covariances: of the path's poses, as tangents on the right, translation first; None if unknown.
        frames: the recorded images; None if there are none.
        notes: why something is not there, one sentence each.
        max_gaussians: Gaussians that a browser draws at most; a larger map is drawn as a sample.
        drawn_by: who draws the map at first. The library draws it where the browser has no graphics card;
            it needs `gaussians`.

    Attributes:
        server: the viser server.
        splats: the map's scene node, `/map`.
        path: the path's line, `/trajectory/path`; None without a trajectory.
        frusta: a camera frustum per keyframe, `/trajectory/keyframes/I`.
        replay: the frustum of the replayed frame, `/replay`; None without a trajectory.
        controls: viser's handles of the page's inputs by their labels; a value that is set changes the page.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        splats: Splats,
        trajectory: Trajectory,
        keyframes: Trajectory,
        *,
        gaussians: Gaussians | None = None,
        camera: Camera | None = None,
        covariances: Float[np.ndarray, "n 6 6"] | None = None,
        frames: RecordedFrames | None = None,
        notes: tuple[str, ...] = (),
        max_gaussians: int = MOST_GAUSSIANS,
        drawn_by: Drawer = "browser",
    ) -> None:
        super().__init__(server)
        self._trajectory, self._keyframes = trajectory, keyframes
        self._index, self._look = 0, Look()
        # Rendering may have to compile first; the map's colours don't wait for it.
        self._sending, self._rendering = Latest("sending"), Latest("rendering")
        self._stage = Stage(server, splats, trajectory, keyframes, camera, covariances, max_gaussians)
        self.splats = self._stage.map.node
        path = self._stage.path
        self.path, self.replay = (None, None) if path is None else (path.line, path.replay)
        self.frusta = [] if path is None else path.frusta

        self._files: MapFiles | None = None
        self._panel: FramePanel | None = None
        self._server_rendering: ServerRendering | None = None
        if gaussians is not None:
            painter = Painter(gaussians, splats, self._stage.axes, keyframes, camera)
            self._server_rendering = ServerRendering(server, painter)
            self._files = MapFiles(painter, trajectory)
            if path is not None:
                self._panel = FramePanel(server.gui, painter, trajectory, camera, frames)
        self._add_controls(camera, notes, drawn_by)
        self._draw(self._look)
        self.show_frame(0)
        server.on_client_connect(lambda _: self._draw_frame())

    def close(self) -> None:
        """Stop the replay and the server."""
        if self._clock is not None:
            self._clock.close()
        if self._downloads is not None:
            self._downloads.close()
        self._sending.close()
        self._rendering.close()
        if self._server_rendering is not None:
            self._server_rendering.close()
        self.server.stop()

    def show_map(
        self,
        *,
        mode: Mode = "splats",
        size: float = 1.0,
        least_opacity: float = 0.0,
        crop: Box | None = None,
    ) -> None:
        """Draw the map another way; it is sent to the browsers where that changes it.

        Args:
            mode: what is drawn; docs/viewer.md explains the modes.
            size: factor on the standard deviations.
            least_opacity: Gaussians below this opacity are hidden.
            crop: what is outside this box is hidden; None hides nothing.
        """
        self._draw(Look(mode, size, least_opacity, crop))

    def show_frame(self, index: int, *, follow: bool = False) -> None:
        """Put the replay's camera at a pose of the trajectory, and show its images.

        Args:
            index: position in the trajectory.
            follow: take every browser's camera there too.
        """
        if self._stage.path is None:
            return
        self._index = index
        pose = self._trajectory.poses[index]
        self._stage.path.place_replay(pose)
        if follow:
            self._stage.look_from(pose, None)
        self._stage.make_way()
        self._draw_frame()

    def pictures(self) -> tuple[UInt8[np.ndarray, "h w 3"] | None, UInt8[np.ndarray, "h w 3"]]:
        """The pictures of the replayed frame, as the page shows them.

        Returns:
            The recorded one, or None if it is not there, and the map from its pose.

        Raises:
            InputError: there is no path, or the scene was made without `gaussians`.
        """
        if self._panel is None:
            raise InputError("Pictures of a frame need `gaussians` and a path.")
        return self._panel.pictures(self._index, self._look)

    def set_up(self, *, level: bool) -> None:
        """Choose which way is up.

        Args:
            level: as the map's planes tell, if they do; otherwise as the first camera was held.
        """
        self._stage.set_up(level=level)

    def box(self, low: tuple[float, float, float], high: tuple[float, float, float]) -> Box:
        """A box to crop with, along the level axes.

        Args:
            low: least coordinates to the right, ahead and up, metres.
            high: largest coordinates.
        """
        return Box(self._stage.axes, np.array(low, float), np.array(high, float))

    def save_still(
        self,
        path: Path | str,
        *,
        width: int,
        height: int,
        T_world_cam: Float[np.ndarray, "4 4"] | None = None,
    ) -> None:
        """Write an image of the map, as it is shown, as PNG.

        Args:
            path: the file; one that exists is replaced.
            width: of the image, pixels.
            height: of the image, pixels.
            T_world_cam: pose of the camera; None takes the replayed frame's.

        Raises:
            InputError: the size is out of range, or there is no map or no pose to take.
        """
        if T_world_cam is None and not len(self._trajectory):
            raise InputError("Without a path an image needs the pose T_world_cam.")
        pose = self._trajectory.poses[self._index] if T_world_cam is None else T_world_cam
        self._save_image(Path(path), view_camera(self._stage.fov, width, height), pose)

    def save_video(
        self,
        path: Path | str,
        *,
        width: int,
        height: int,
        speed: float = 1.0,
        progress: Callable[[float], bool] = lambda _: True,
    ) -> bool:
        """Write a video of the map along the path as MP4.

        Args:
            path: the file; one that exists is replaced.
            width: of the images, pixels; an odd one is made even.
            height: of the images, pixels; an odd one is made even.
            speed: seconds of the recording per second.
            progress: told the share that is done; it answers whether to go on.

        Returns:
            Whether it went to the end; a file that did not is removed.

        Raises:
            InputError: there is no map or path, the size is out of range, or the file can't be written.
        """
        return self._needed_files().video(
            Path(path),
            view_camera(self._stage.fov, width // 2 * 2, height // 2 * 2),
            self._look,
            dark=self._map_controls.dark,
            speed=speed,
            progress=progress,
        )

    def save_map(self, path: Path | str) -> None:
        """Write the Gaussians that are shown; the suffix .ply, .spz, .glb or .splat names the format.

        Args:
            path: the file; one that exists is replaced.

        Raises:
            InputError: the suffix names no format, or nothing is shown.
        """
        self._needed_files().map(Path(path), self._look)

    def _needed_files(self) -> MapFiles:
        if self._files is None:
            raise InputError("The scene was made without `gaussians`: it can't write files of them.")
        return self._files

    def _add_controls(self, camera: Camera | None, notes: tuple[str, ...], drawn_by: Drawer) -> None:
        stage, gui = self._stage, self.server.gui
        tabs = gui.add_tab_group()
        with tabs.add_tab("Map"):
            drawer = None if self._server_rendering is None else drawn_by
            self._map_controls = MapControls(gui, stage, drawer, on_look=self._look_chosen)
        self._clock: Replay | None = None
        self._replay_controls: ReplayControls | None = None
        if stage.path is not None:
            with tabs.add_tab("Replay"):
                self._replay_controls = ReplayControls(
                    gui,
                    self._trajectory,
                    stage.path,
                    on_frame=self._frame_chosen,
                    on_follow=self._follow_chosen,
                    on_play=self._play_chosen,
                )
            stage.path.on_keyframe(self._keyframe_clicked)
            self._clock = Replay(self._trajectory.timestamps, self._frame_come)
        self._downloads: Downloads | None = None
        if self._files is not None:
            with tabs.add_tab("Save"):
                controls = SaveControls(gui, camera, has_path=stage.path is not None)
            self._downloads = Downloads(controls, self._save_view, self._save_path, self.save_map)
        self.controls = self._map_controls.inputs | (
            {} if self._replay_controls is None else self._replay_controls.inputs
        )
        for note in notes:
            gui.add_markdown(plain_text(note))

    def _look_chosen(self) -> None:
        """Draw what the controls say, once they rest."""
        self._sending.call("map", lambda: self._draw(self._map_controls.look), rest_s=_REST_S)

    def _frame_chosen(self) -> None:
        """Go to the frame of the slider, which the replay and a keyframe move as well."""
        controls = self._replay_controls
        if controls is None or self._clock is None or controls.frame == self._index:
            return
        self._clock.go_to(controls.frame)
        self.show_frame(controls.frame, follow=controls.follow)

    def _follow_chosen(self) -> None:
        controls = self._replay_controls
        if controls is not None and controls.follow:
            self.show_frame(self._index, follow=True)
        else:
            self._stage.let_go()

    def _frame_come(self, index: int) -> None:
        """Go to the frame whose time has come."""
        if self._replay_controls is not None:
            self.show_frame(index, follow=self._replay_controls.follow)
            self._replay_controls.frame = index

    def _play_chosen(self) -> None:
        controls = self._replay_controls
        if controls is None or self._clock is None:
            return
        if controls.playing:
            self._clock.play(speed=controls.speed)
        else:
            self._clock.pause()

    def _keyframe_clicked(self, keyframe: int, client: viser.ClientHandle | None) -> None:
        """Take the browser to the keyframe, and the replay to its frame."""
        times = self._trajectory.timestamps
        index = int(np.argmin(np.abs(times - self._keyframes.timestamps[keyframe])))
        self.show_frame(index)
        if self._replay_controls is not None and self._clock is not None:
            self._replay_controls.frame = index
            self._clock.go_to(index)
        self._stage.look_from(self._keyframes.poses[keyframe], client)

    def _draw(self, look: Look) -> None:
        self._look = look
        here = self._server_rendering if self._map_controls.drawn_by == "library" else None
        self._map_controls.explain(self._stage.map.show(look, drawn=here is None))
        if here is not None:
            here.show(look, dark=self._map_controls.dark)
        elif self._server_rendering is not None:
            self._server_rendering.hide()
        self._draw_frame()

    def _draw_frame(self) -> None:
        """Renew the pictures of the frame, if somebody looks."""
        panel, path = self._panel, self._stage.path
        if panel is None or path is None or not self.server.get_clients():
            return
        index, look = self._index, self._look
        self._rendering.call("frame", lambda: path.show_picture(panel.draw(index, look)))

    def _save_view(self, path: Path, client: viser.ClientHandle, width: int, height: int) -> None:
        camera = view_camera(float(client.camera.fov), width, height)
        self._save_image(path, camera, pose_of(client.camera))

    def _save_image(self, path: Path, camera: Camera, T_world_cam: Float[np.ndarray, "4 4"]) -> None:
        self._needed_files().still(path, T_world_cam, camera, self._look, dark=self._map_controls.dark)

    def _save_path(self, path: Path, width: int, height: int, progress: Callable[[float], bool]) -> bool:
        speed = 1.0 if self._replay_controls is None else self._replay_controls.speed
        return self.save_video(path, width=width, height=height, speed=speed, progress=progress)
