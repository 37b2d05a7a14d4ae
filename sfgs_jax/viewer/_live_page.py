"""The page of a run in progress: state and controls on the right, images and plots on the left."""

import numpy as np
import viser

from sfgs_jax.viewer._live_plots import LivePlots
from sfgs_jax.viewer._live_scene import LAYERS, LiveScene
from sfgs_jax.viewer._plain_text import plain_text
from sfgs_jax.viewer._run_control import RunControl

_PANEL_WIDTH = 400

_COMPILING = "**Compiling**, about a minute for the first run of an image size"

FREE, BEHIND, THROUGH = VIEWPOINTS = ("free", "behind the camera", "through the camera")
"""Choices for the browser's camera."""


class LivePage:
    """Controls of a run and of its scene, images and plots.

    Args:
        server: the viser server.
        scene: the scene.
        control: of the run.
        name: of the run.
        with_truth: whether there is ground truth.
        with_saving: whether the results so far can be written.

    Attributes:
        picture: the images of the newest frame.
        plots: the plots.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        scene: LiveScene,
        control: RunControl,
        *,
        name: str,
        with_truth: bool,
        with_saving: bool,
    ) -> None:
        gui = server.gui
        gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
        gui.set_panel_label(name)
        gui.main_panel.dock_right()
        self._control = control
        self._headline = gui.add_markdown(_COMPILING)
        self._bar = gui.add_progress_bar(0.0)
        self._note = gui.add_markdown("", visible=False)
        self._add_buttons(gui, with_saving=with_saving)
        self._facts = gui.add_markdown("", visible=False)
        with gui.add_folder("View"):
            self._viewpoint = gui.add_dropdown("From", VIEWPOINTS, hint="Place of the browser's camera.")
        self._add_layers(gui, scene, with_truth=with_truth)
        panel = gui.add_panel()
        with panel.add_tab("Newest frame") as tab:
            self.picture = gui.add_image(np.zeros((480, 640, 3), np.uint8), jpeg_quality=80)
        self.plots = LivePlots(server, tab, with_truth=with_truth)
        panel.dock_left()
        panel.set_width(_PANEL_WIDTH)

    @property
    def viewpoint(self) -> str:
        """One of `VIEWPOINTS`."""
        return self._viewpoint.value

    def tell(self, headline: str, done: float) -> None:
        """Say what the run is doing.

        Args:
            headline: in a few words.
            done: share of the work that is done, in [0, 1].
        """
        self._headline.content = f"**{headline}**"
        self._bar.value = 100 * min(max(done, 0.0), 1.0)

    def tell_facts(self, facts: dict[str, str]) -> None:
        """Show figures of the run.

        Args:
            facts: values by their names.
        """
        rows = [f"| {name} | {value} |" for name, value in facts.items()]
        self._facts.content = "\n".join(["| | |", "|:--|--:|", *rows])
        self._facts.visible = True

    def note(self, text: str) -> None:
        """Show a message below the bar.

        Args:
            text: the message, no markdown.
        """
        self._note.content, self._note.visible = plain_text(text), True

    def end(self, headline: str) -> None:
        """Say that the run has ended; there is nothing left to control.

        Args:
            headline: in a few words.
        """
        self.tell(headline, 1.0)
        for button in self._buttons:
            button.disabled = True

    def _add_buttons(self, gui: viser.GuiApi, *, with_saving: bool) -> None:
        control, icon = self._control, viser.Icon
        pause = gui.add_button("Pause", icon=icon.PLAYER_PAUSE, hint="Wait after the frame in work.")
        step = gui.add_button("Step", icon=icon.PLAYER_TRACK_NEXT, hint="One frame, then wait.")
        save = gui.add_button(
            "Save", icon=icon.DEVICE_FLOPPY, hint="Write the results so far.", visible=with_saving
        )
        stop = gui.add_button(
            "Stop", icon=icon.PLAYER_STOP, color="red", hint="End the run and write its results."
        )
        self._buttons = (pause, step, save, stop)

        def show_state() -> None:
            pause.label = "Resume" if control.paused else "Pause"
            pause.icon = icon.PLAYER_PLAY if control.paused else icon.PLAYER_PAUSE

        @pause.on_click
        def _(_: viser.GuiEvent) -> None:
            (control.resume if control.paused else control.pause)()
            show_state()

        @step.on_click
        def _(_: viser.GuiEvent) -> None:
            control.step()
            show_state()

        @save.on_click
        def _(_: viser.GuiEvent) -> None:
            control.save()

        @stop.on_click
        def _(_: viser.GuiEvent) -> None:
            control.stop()
            self.note("The run stops after the frame in work.")

    def _add_layers(self, gui: viser.GuiApi, scene: LiveScene, *, with_truth: bool) -> None:
        with gui.add_folder("Show"):
            for name in LAYERS:
                if name != "Ground truth" or with_truth:
                    self._add_layer(gui, name, scene.layers[name])
            magnification = gui.add_slider(
                "3 sigma ×",
                min=1,
                max=50,
                step=1,
                initial_value=1,
                hint="Draws the uncertainty of the positions larger than it is.",
            )

        @magnification.on_update
        def _(_: viser.GuiEvent) -> None:
            scene.magnify(magnification.value)

    def _add_layer(self, gui: viser.GuiApi, name: str, layer: viser.FrameHandle) -> None:
        box = gui.add_checkbox(name, initial_value=True)

        @box.on_update
        def _(_: viser.GuiEvent) -> None:
            layer.visible = box.value
