"""The map in the browser's scene."""

import numpy as np
import viser
from jaxtyping import Float, Float32

from sfgs_jax.geometry import Camera, Trajectory
from sfgs_jax.viewer._modes import Look, count_views, depth_range, depths_from, normal_colours, turbo
from sfgs_jax.viewer._splats import Splats, sampled

_POINT_SIZE = 0.9
"""Diameter of a point, in standard deviations of a middling Gaussian."""


_OUTSIDE = 1.5
"""Factor on depths from the path, because the browser looks from farther away."""


class MapLayer:
    """The Gaussians as splats, and as points.

    Args:
        scene: of the server.
        splats: the whole map.
        axes: rows: right, forward and up.
        keyframes: cameras that the map was made from; may be empty.
        camera: their intrinsics; None if they are not known.
        most: Gaussians that are sent at most; a larger map is sent as a sample.

    Attributes:
        node: the splats' node, `/map`.
        points: the points' node, `/points`; None until they are asked for.
        sent: the Gaussians that are drawn from.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        splats: Splats,
        axes: Float[np.ndarray, "3 3"],
        keyframes: Trajectory,
        camera: Camera | None,
        most: int,
    ) -> None:
        self._scene, self._axes, self._keyframes, self._camera = scene, axes, keyframes, camera
        self._total = len(splats)
        self.sent = sampled(splats, most)
        self._colours: dict[str, tuple[Float32[np.ndarray, "n 3"], str]] = {}
        self._foggy = False
        first = self.sent[:1]
        self.node = scene.add_gaussian_splats(
            "/map", first.centres, first.covariances, first.rgb, first.opacities, visible=False
        )
        self.points: viser.PointCloudHandle | None = None

    def note(self, *, whole: bool) -> str:
        """Number of Gaussians, and how many of them are drawn: all, or those that are sent."""
        if whole or len(self.sent) == self._total:
            return f"{self._total:,} Gaussians"
        return (
            f"{self._total:,} Gaussians. The page draws a sample of {len(self.sent):,}, enlarged to fill "
            "the gaps. Images and files hold all of them."
        )

    def show(self, look: Look, *, drawn: bool = True) -> str:
        """Draw the map another way. Sends nothing where nothing changes.

        Args:
            look: what to draw.
            drawn: False takes it from the browsers, because something else draws it.

        Returns:
            What the colours mean.
        """
        colours, legend = self._coloured(look.mode)
        shown = look.shown(self.sent.centres, self.sent.opacities[:, 0]) & drawn
        any_shown, as_points = bool(shown.any()), look.mode == "points"
        self._fog(drawn and look.mode == "depth")
        if any_shown and as_points:
            self._show_points(look, shown)
        elif any_shown:
            self._send(self.sent[shown], look.size, colours[shown])
        elif not drawn:
            # Even hidden Gaussians cost a browser without a graphics card seconds.
            self._send(self.sent[:1], look.size, colours[:1])
        self.node.visible = any_shown and not as_points
        if self.points is not None:
            self.points.visible = any_shown and as_points
        return legend

    def _send(self, splats: Splats, size: float, colours: Float32[np.ndarray, "n 3"]) -> None:
        scaled = splats.covariances * np.float32(size**2)
        self.node.set_gaussians(splats.centres, scaled, colours, splats.opacities)

    def _show_points(self, look: Look, shown: np.ndarray) -> None:
        drawn = self.sent[shown]
        sigma = np.sqrt(np.median(np.trace(self.sent.covariances, axis1=1, axis2=2)) / 3)
        size = float(look.size * _POINT_SIZE * sigma)
        if self.points is None:
            self.points = self._scene.add_point_cloud(
                "/points",
                drawn.centres,
                drawn.rgb,
                point_size=size,
                point_shape="circle",
                point_shading="flat",
                precision="float32",
            )
            return
        self.points.point_size = size
        if len(drawn) != len(self.points.points) or not np.array_equal(drawn.centres, self.points.points):
            self.points.points, self.points.colors = drawn.centres, np.round(255 * drawn.rgb).astype(np.uint8)

    def _fog(self, wanted: bool) -> None:
        """Darken with distance, which the browser does as the camera moves."""
        if wanted or self._foggy:
            self._foggy = wanted
            self._scene.configure_fog(0.0, self._far(), color=(0, 0, 0), enabled=wanted)

    def _far(self) -> float:
        """Depth that is black, metres."""
        poses = self._keyframes.poses
        if not len(self.sent):
            return 1.0
        if not len(poses):
            return float(np.linalg.norm(np.ptp(self.sent.centres, axis=0)))
        some = self.sent.centres[:: max(1, len(self.sent) // 5000)]
        farthest = max(depth_range(depths_from(some, pose))[1] for pose in poses[:: max(1, len(poses) // 20)])
        return _OUTSIDE * farthest

    def _coloured(self, mode: str) -> tuple[Float32[np.ndarray, "n 3"], str]:
        """Colours of the Gaussians that are sent, and what they mean."""
        if mode not in self._colours:
            self._colours[mode] = self._colour(mode)
        return self._colours[mode]

    def _colour(self, mode: str) -> tuple[Float32[np.ndarray, "n 3"], str]:
        if mode == "depth":
            return np.ones_like(self.sent.rgb), f"White is near, black is {self._far():.1f} m away."
        if mode == "normals":
            legend = "Size of the normal's components: red to the right, green ahead, blue up."
            return normal_colours(self.sent, self._axes), legend
        if mode == "uncertainty":
            colours, legend = certainty_colours(self.sent, self._keyframes, self._camera)
            return colours, legend
        return self.sent.rgb, ""


def certainty_colours(
    splats: Splats, keyframes: Trajectory, camera: Camera | None
) -> tuple[Float32[np.ndarray, "n 3"], str]:
    """Colours by how well a Gaussian is known, as far as the files of a run tell.

    Args:
        splats: the map.
        keyframes: cameras that the map was made from.
        camera: their intrinsics; None if they are not known.

    Returns:
        Colours from red to blue, and what they mean.
    """
    nothing_stored = "A map stores no covariance of its Gaussians."
    if camera is None or not len(keyframes):
        legend = f"{nothing_stored} Colours show opacity: red is transparent, blue is opaque."
        return turbo(splats.opacities[:, 0]).astype(np.float32) / 255, legend
    views = count_views(splats.centres, keyframes.poses, camera)
    most = max(2, int(np.percentile(views, 95))) if len(views) else 2
    legend = (
        f"{nothing_stored} Colours count the keyframes that have it in view: red is one, blue is {most} or "
        "more. Walls between them are not considered."
    )
    return turbo((views - 1) / (most - 1)).astype(np.float32) / 255, legend
