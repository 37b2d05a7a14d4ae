"""A panel with the recorded image of a frame beside the map from its pose."""

import jax
import numpy as np
import viser
from jaxtyping import Float, UInt8

from sfgs_jax.geometry import Camera, Frame, Trajectory
from sfgs_jax.viewer._finished_run import RecordedFrames
from sfgs_jax.viewer._modes import Look, depth_range
from sfgs_jax.viewer._painting import OPAQUE, Painter, bytes_of, depth_picture
from sfgs_jax.viewer._path_layer import field_of_view

_WIDTH = 320
"""Largest width of a picture, pixels."""

_BLACK = np.zeros(3)


def panel_camera(camera: Camera | None) -> Camera:
    """A camera of the same view with an image that fits a panel.

    Args:
        camera: of the recording; None takes a common one.
    """
    if camera is not None:
        return camera.downscaled(max(1, -(-camera.width // _WIDTH)))
    fov, aspect = field_of_view(None)
    return view_camera(fov, _WIDTH, round(_WIDTH / aspect))


def view_camera(fov: float, width: int, height: int) -> Camera:
    """A camera with square pixels and the principal point in the middle.

    Args:
        fov: vertical field of view, radians.
        width: of the image, pixels.
        height: of the image, pixels.
    """
    focal = 0.5 * height / np.tan(0.5 * fov)
    return Camera(focal, focal, (width - 1) / 2, (height - 1) / 2, width=width, height=height)


class FramePanel:
    """The two pictures of a frame, with a line of text.

    Args:
        gui: of the server.
        painter: renders the map.
        trajectory: the path.
        camera: intrinsics of the recording; None if they are not known.
        frames: the recorded images; None if there are none.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        painter: Painter,
        trajectory: Trajectory,
        camera: Camera | None,
        frames: RecordedFrames | None,
    ) -> None:
        self._painter, self._trajectory, self._frames = painter, trajectory, frames
        self._camera = panel_camera(camera)
        panel = gui.add_panel()
        with panel.add_tab("Frame"):
            blank = np.zeros((*self._camera.shape, 3), np.uint8)
            self.recorded = None if frames is None else gui.add_image(blank, label="Recorded")
            if frames is None:
                gui.add_markdown("The recorded images are not there.")
            self.rendered = gui.add_image(blank, label="Map, as rendered")
            self.text = gui.add_markdown("rendering …")
        panel.float(x=12, y=12, width=300)

    def draw(self, index: int, look: Look) -> UInt8[np.ndarray, "h w 3"] | None:
        """Show a frame of the path.

        Args:
            index: position in the path.
            look: what to draw; of the map and, where it is depth, of the recording.

        Returns:
            The recorded picture; None if there is none.
        """
        frame = self._frame(index)
        if frame is not None and look.mode != "depth":
            # Rendering may have to compile first.
            self._show_recorded(self._colours(frame))
        recorded, rendered = self._pictures(frame, index, look)
        self.rendered.image = rendered
        self._show_recorded(np.zeros_like(rendered) if recorded is None else recorded)
        elapsed = self._trajectory.timestamps[index] - self._trajectory.timestamps[0]
        text = f"Frame {index + 1} of {len(self._trajectory)}, {elapsed:.2f} s"
        unreadable = frame is None and self._frames is not None
        self.text.content = f"{text}. The recorded image can't be read." if unreadable else text
        return recorded

    def pictures(
        self, index: int, look: Look
    ) -> tuple[UInt8[np.ndarray, "h w 3"] | None, UInt8[np.ndarray, "h w 3"]]:
        """The recorded picture, or None, and the rendered one; arguments as of `draw`."""
        return self._pictures(self._frame(index), index, look)

    def _pictures(
        self, frame: Frame | None, index: int, look: Look
    ) -> tuple[UInt8[np.ndarray, "h w 3"] | None, UInt8[np.ndarray, "h w 3"]]:
        rendered, limits = self._rendered(index, look)
        return None if frame is None else self._recorded(frame, limits), rendered

    def _frame(self, index: int) -> Frame | None:
        return None if self._frames is None else self._frames.frame(index)

    def _show_recorded(self, picture: UInt8[np.ndarray, "h w 3"]) -> None:
        if self.recorded is not None:
            self.recorded.image = picture

    def _rendered(
        self, index: int, look: Look
    ) -> tuple[UInt8[np.ndarray, "h w 3"], tuple[float, float] | None]:
        """The map from the frame's pose, and the range of its colours if it shows depth."""
        shutter = None if self._frames is None else self._frames.shutter(index)
        output = self._painter.render(
            self._trajectory.poses[index], self._camera, look, background=_BLACK, shutter=shutter
        )
        if look.mode == "depth":
            depth = np.where(np.asarray(output.alpha) > OPAQUE, np.asarray(output.depth), 0)
            limits = depth_range(depth)
            return depth_picture(depth, background=_BLACK, limits=limits), limits
        if look.mode == "splats" and self._frames is not None:
            return bytes_of(jax.device_get(self._frames.shown(index, output.rgb))), None
        return bytes_of(jax.device_get(output.rgb)), None

    def _recorded(self, frame: Frame, limits: tuple[float, float] | None) -> UInt8[np.ndarray, "h w 3"]:
        if limits is None:
            return self._colours(frame)
        factor = frame.depth.shape[1] // self._camera.width
        # One pixel of each block: a mean over a border would be of neither surface.
        depth = np.asarray(frame.depth)[factor // 2 :: factor, factor // 2 :: factor]
        return depth_picture(
            depth[: self._camera.height, : self._camera.width], background=_BLACK, limits=limits
        )

    def _colours(self, frame: Frame) -> UInt8[np.ndarray, "h w 3"]:
        return bytes_of(self._small(np.asarray(frame.rgb)))

    def _small(self, rgb: Float[np.ndarray, "H W 3"]) -> Float[np.ndarray, "h w 3"]:
        """Means over blocks of pixels, the image of the panel's camera."""
        height, width = self._camera.shape
        factor = rgb.shape[1] // width
        blocks = rgb[: height * factor, : width * factor].reshape(height, factor, width, factor, 3)
        return blocks.mean(axis=(1, 3))
