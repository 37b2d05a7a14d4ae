"""The controls of a finished run's page, in three tabs."""

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
import viser

from sfgs_jax.geometry import Camera, Trajectory
from sfgs_jax.viewer._cropping import Box
from sfgs_jax.viewer._files import LARGEST_SIDE, MAP_FORMATS, SMALLEST_SIDE
from sfgs_jax.viewer._modes import MODES, Look, Mode
from sfgs_jax.viewer._path_layer import ENLARGEMENTS, PathLayer
from sfgs_jax.viewer._server_rendering import DRAWERS, Drawer
from sfgs_jax.viewer._stage import Stage

_SPEEDS: Mapping[str, float] = MappingProxyType(
    {"0.1 ×": 0.1, "0.25 ×": 0.25, "0.5 ×": 0.5, "1 ×": 1.0, "2 ×": 2.0, "5 ×": 5.0, "10 ×": 10.0}
)
_MODE_NAMES: Mapping[str, Mode] = MappingProxyType({mode.capitalize(): mode for mode in MODES})
_AXES = ("Right", "Ahead", "Up")

_NO_LEVEL = "The map has no planes that tell which way is up. It is as the first camera was held."


class MapControls:
    """The look of the map, what is cropped, and which way is up.

    Args:
        gui: of the server.
        stage: whose map it is.
        drawn_by: who draws the map at first; None where the browser has to.
        on_look: told that the map should be drawn another way.

    Attributes:
        inputs: viser's handles by their labels.
    """

    def __init__(
        self, gui: viser.GuiApi, stage: Stage, drawn_by: Drawer | None, *, on_look: Callable[[], None]
    ) -> None:
        self._gui, self._stage = gui, stage
        low, high = stage.low, np.maximum(stage.high, stage.low + 0.1)
        self._note = gui.add_markdown("")
        self._drawer = gui.add_dropdown(
            "Drawn by",
            DRAWERS,
            initial_value=drawn_by or "browser",
            visible=drawn_by is not None,
            hint="The library draws all Gaussians and sends images: for browsers without a graphics card.",
        )
        self._mode = gui.add_dropdown(
            "Show", tuple(_MODE_NAMES), hint="Colours of the map, or something else."
        )
        self._legend = gui.add_markdown("", visible=False)
        self._size = gui.add_slider(
            "Size", 0.1, 2.0, 0.05, 1.0, hint="Factor on every Gaussian. Small ones show where they lie."
        )
        self._opacity = gui.add_slider(
            "Least opacity", 0.0, 1.0, 0.02, 0.0, hint="Hides Gaussians that are more transparent."
        )
        self._crop = gui.add_checkbox(
            "Crop", False, hint="Hides the map outside a box. Saved maps are cropped."
        )
        self._ranges = [
            gui.add_multi_slider(
                name, float(a), float(b), 0.05, (float(a), float(b)), visible=False, hint="Metres."
            )
            for name, a, b in zip(_AXES, low, high, strict=True)
        ]
        gui.add_divider()
        without = stage.level is None
        self._up = gui.add_button_group("Up is", ("Level", "As recorded"), disabled=without)
        if without:
            gui.add_markdown(_NO_LEVEL)
        self._floor = gui.add_checkbox("Floor", False, disabled=without, hint="A grid with a line a metre.")
        self._dark = gui.add_checkbox("Dark", True, hint="Black behind the map, here and in saved images.")
        ranges = dict(zip(_AXES, self._ranges, strict=True))
        self.inputs: dict[str, viser.GuiInputHandle] = {
            "Drawn by": self._drawer,
            "Show": self._mode,
            "Size": self._size,
            "Least opacity": self._opacity,
            "Crop": self._crop,
            **ranges,
            "Floor": self._floor,
            "Dark": self._dark,
        }
        self._listen(on_look)
        self._set_theme()

    @property
    def look(self) -> Look:
        """What the controls say."""
        return Look(_MODE_NAMES[self._mode.value], self._size.value, self._opacity.value, self.crop)

    @property
    def drawn_by(self) -> Drawer:
        """Who draws the map."""
        return self._drawer.value

    @property
    def crop(self) -> Box | None:
        """The crop box; None while nothing is cropped."""
        if not self._crop.value:
            return None
        low, high = np.array([control.value for control in self._ranges]).T
        return Box(self._stage.axes, low, high)

    @property
    def dark(self) -> bool:
        """True if black is behind the map."""
        return self._dark.value

    def explain(self, legend: str) -> None:
        """Say how many Gaussians are drawn, and what the colours mean; nothing if that is plain."""
        self._note.content = self._stage.map.note(whole=self.drawn_by == "library")
        self._legend.content, self._legend.visible = legend, bool(legend)

    def _listen(self, on_look: Callable[[], None]) -> None:
        stage = self._stage

        def crop_changed(_: viser.GuiEvent) -> None:
            for control in self._ranges:
                control.visible = self._crop.value
            stage.show_box(self.crop)
            on_look()

        for control in (self._drawer, self._mode, self._size, self._opacity):
            control.on_update(lambda _: on_look())
        for control in (self._crop, *self._ranges):
            control.on_update(crop_changed)
        self._up.on_click(lambda _: stage.set_up(level=self._up.value == "Level"))
        self._floor.on_update(lambda _: stage.show_floor(self._floor.value))
        self._dark.on_update(lambda _: self._set_theme())
        self._dark.on_update(lambda _: on_look())

    def _set_theme(self) -> None:
        # viser's share button would publish the page through a server of others.
        self._gui.configure_theme(dark_mode=self.dark, show_logo=False, show_share_button=False)


class ReplayControls:
    """The frame that is replayed, and what is drawn of the path.

    Args:
        gui: of the server.
        trajectory: the path.
        path: its nodes.
        on_frame: told that the slider has moved.
        on_follow: told that the view should go with the frame, or no longer.
        on_play: told that playing, or its speed, has changed.

    Attributes:
        inputs: viser's handles by their labels.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        trajectory: Trajectory,
        path: PathLayer,
        *,
        on_frame: Callable[[], None],
        on_follow: Callable[[], None],
        on_play: Callable[[], None],
    ) -> None:
        self._last = len(trajectory) - 1
        single, unknown = self._last < 1, path.uncertainty is None
        self._frame = gui.add_slider("Frame", 0, max(self._last, 1), 1, 0, disabled=single)
        self._play = gui.add_checkbox("Play", False, disabled=single, hint="By the recording's own clock.")
        self._speed = gui.add_dropdown("Speed", tuple(_SPEEDS), initial_value="1 ×")
        self._follow = gui.add_checkbox(
            "Look from there",
            False,
            hint="Takes the view to the frame's pose, with the camera's field of view.",
        )
        gui.add_divider()
        line = gui.add_checkbox("Path", True)
        keyframes = gui.add_checkbox(
            "Keyframes", True, hint="Click one to look from there and to see its image."
        )
        sigmas = gui.add_checkbox(
            "Uncertainty", False, disabled=unknown, hint="Three standard deviations of the positions."
        )
        enlarged = gui.add_dropdown(
            "Enlarged", tuple(map(str, ENLARGEMENTS)), initial_value=str(path.enlargement), visible=False
        )
        explained = gui.add_markdown(
            "Ellipsoids of three standard deviations, times the factor above. Without it, half of them "
            f"reach farther than {3000 * path.median_sigma:.1f} mm.",
            visible=False,
        )

        def show(_: viser.GuiEvent) -> None:
            path.show(path=line.value, keyframes=keyframes.value, uncertainty=sigmas.value)
            enlarged.visible = explained.visible = sigmas.value

        for control in (line, keyframes, sigmas):
            control.on_update(show)
        enlarged.on_update(lambda _: path.enlarge(int(enlarged.value)))
        self.inputs: dict[str, viser.GuiInputHandle] = {
            "Frame": self._frame,
            "Play": self._play,
            "Speed": self._speed,
            "Look from there": self._follow,
            "Path": line,
            "Keyframes": keyframes,
            "Uncertainty": sigmas,
            "Enlarged": enlarged,
        }
        self._frame.on_update(lambda _: on_frame())
        self._follow.on_update(lambda _: on_follow())
        for control in (self._play, self._speed):
            control.on_update(lambda _: on_play())

    @property
    def frame(self) -> int:
        """Index of the frame."""
        return min(self._frame.value, self._last)

    @frame.setter
    def frame(self, index: int) -> None:
        self._frame.value = index

    @property
    def playing(self) -> bool:
        """True if the replay runs."""
        return self._play.value

    @property
    def speed(self) -> float:
        """Seconds of the recording per second."""
        return _SPEEDS[self._speed.value]

    @property
    def follow(self) -> bool:
        """True if the view goes with the replay."""
        return self._follow.value


class SaveControls:
    """Buttons that give files to the browser.

    Args:
        gui: of the server.
        camera: whose image size is offered first; None offers 640 x 480.
        has_path: whether there is a path for a video.
    """

    def __init__(self, gui: viser.GuiApi, camera: Camera | None, *, has_path: bool) -> None:
        height, width = (480, 640) if camera is None else camera.shape
        low, high = SMALLEST_SIDE, LARGEST_SIDE
        gui.add_markdown("Rendered here from all Gaussians. The browser downloads the file.")
        self._width = gui.add_number("Width", width, min=low, max=high, step=2)
        self._height = gui.add_number("Height", height, min=low, max=high, step=2)
        self._still = gui.add_button("Image of this view", icon=viser.Icon.CAMERA)
        self._video = gui.add_button(
            "Video of the replay", icon=viser.Icon.VIDEO, disabled=not has_path, hint="At the replay's speed."
        )
        self._progress = gui.add_progress_bar(0, visible=False)
        self._stop = gui.add_button("Stop", visible=False)
        gui.add_divider()
        self._format = gui.add_dropdown("Format", tuple(name.upper() for name in MAP_FORMATS))
        self._map = gui.add_button("Map", icon=viser.Icon.DOWNLOAD, hint="The Gaussians that are shown.")

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the images, pixels."""
        return int(self._width.value), int(self._height.value)

    def on_still(self, told: Callable[[viser.ClientHandle], None]) -> None:
        """Call a function with the browser that asks for an image."""
        self._still.on_click(lambda event: event.client and told(event.client))

    def on_video(self, told: Callable[[viser.ClientHandle], None]) -> None:
        """Call a function with the browser that asks for a video."""
        self._video.on_click(lambda event: event.client and told(event.client))

    def on_map(self, told: Callable[[viser.ClientHandle, str], None]) -> None:
        """Call a function with the browser that asks for the map, and the suffix of the format."""
        self._map.on_click(lambda event: event.client and told(event.client, self._format.value.lower()))

    def on_stop(self, told: Callable[[], None]) -> None:
        """Call a function when a video should end."""
        self._stop.on_click(lambda _: told())

    def show_progress(self, share: float | None) -> None:
        """Show how far a video is; None when it has ended."""
        self._progress.visible = self._stop.visible = share is not None
        self._video.disabled = share is not None
        self._progress.value = 0 if share is None else 100 * share
