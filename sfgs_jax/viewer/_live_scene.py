"""The scene of a run in progress: map, path and its uncertainty, ground truth, keyframes, loops, camera."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import trimesh
import viser
from jaxtyping import Float, UInt8

from sfgs_jax.geometry import Camera, Trajectory, quaternions_from_rotations, se3
from sfgs_jax.slam import SlamState, View
from sfgs_jax.slam.state import maps_of
from sfgs_jax.splatting import Gaussians
from sfgs_jax.viewer._splats import splats_of
from sfgs_jax.viewer._viewpoints import place_behind, vertical_field_of_view

LAYERS = ("Map", "Path", "Uncertainty", "Ground truth", "Keyframes", "Loops", "Camera")
"""Parts of the scene that can be hidden."""

_PATH_COLOUR, _TRUTH_COLOUR, _LOOP_COLOUR = (59, 130, 246), (132, 204, 22), (251, 146, 60)
_KEYFRAME_COLOUR, _CAMERA_COLOUR = (148, 163, 184), (239, 68, 68)

_MARKS = "/live/marks"

_SIGMAS = 3.0
_MOST_ELLIPSOIDS = 150
_THUMBNAIL_WIDTH = 96


class LiveScene:
    """Draws the state of a run in a viser server's scene.

    Args:
        server: the viser server.

    Attributes:
        layers: a node for each of `LAYERS`; its `visible` shows or hides the layer.
        splats: the map's node; None before the first Gaussian.
        keyframes: frustum of each keyframe that has become a view of the map, by its number.
    """

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        # Recordings start about level, and the world is the first camera's: y points down.
        server.scene.set_up_direction("-y")
        server.scene.configure_default_lights(cast_shadow=False)
        server.initial_camera.position, server.initial_camera.look_at = place_behind(np.eye(4))
        self._marks = server.scene.add_frame(_MARKS, show_axes=False)
        self.layers = {name: server.scene.add_frame(_node(name), show_axes=False) for name in LAYERS}
        self.splats: viser.GaussianSplatHandle | None = None
        self.keyframes: dict[int, viser.CameraFrustumHandle] = {}
        self._camera: viser.CameraFrustumHandle | None = None
        self._shown: Gaussians | None = None
        self._most_shown: int | None = None
        self._magnification = 1.0
        self._ellipsoids: viser.BatchedMeshHandle | None = None

    def show(
        self,
        state: SlamState,
        trajectory: Trajectory,
        covariances: Float[np.ndarray, "n 6 6"],
        truth: Trajectory | None,
        *,
        most_gaussians: int | None,
    ) -> None:
        """Draw a state; parts that have not changed are not sent again.

        Args:
            state: of the run, with at least one tracked frame.
            trajectory: its path.
            covariances: of these poses.
            truth: true path in the run's world frame, if it is known.
            most_gaussians: number of Gaussians to draw; of more, the ones that cover most. None draws all.
        """
        self._show_map(state.gaussians, most_gaussians)
        with self._server.atomic():
            self._show_path(state, trajectory)
            if truth is not None:
                self._lines("Ground truth", _consecutive(truth.positions), _TRUTH_COLOUR)
            self._show_uncertainty(trajectory, covariances)
            self._show_keyframes(state)
            poses = state.graph.poses
            loops = [(edge.target, edge.source) for edge in state.graph.loops]
            self._lines("Loops", poses[:, 4:][np.asarray(loops, int).reshape(-1, 2)], _LOOP_COLOUR)

    def show_camera(self, camera: Camera, T_world_cam: Float[np.ndarray, "4 4"]) -> None:
        """Draw the camera.

        Args:
            camera: its intrinsics.
            T_world_cam: its pose.
        """
        if self._camera is None:
            self._camera = self._frustum(_node("Camera", "frustum"), camera, _CAMERA_COLOUR, 0.16, None)
        _place(self._camera, T_world_cam)

    def show_marks(self, visible: bool) -> None:
        """Show or hide all that is not the map.

        Args:
            visible: whether the layers are to be seen that are not hidden themselves.
        """
        self._marks.visible = visible

    def magnify(self, factor: float) -> None:
        """Draw the uncertainty larger than it is.

        Args:
            factor: on the standard deviations.
        """
        if self._ellipsoids is not None and self._ellipsoids.batched_scales is not None:
            self._ellipsoids.batched_scales = self._ellipsoids.batched_scales * (factor / self._magnification)
        self._magnification = factor

    def _show_map(self, gaussians: Gaussians, most: int | None) -> None:
        if gaussians is self._shown and most == self._most_shown:
            return
        self._shown, self._most_shown = gaussians, most
        splats = splats_of(gaussians if most is None else _largest(gaussians, most))
        arrays = (splats.centres, splats.covariances, splats.rgb, splats.opacities)
        if self.splats is not None:
            self.splats.set_gaussians(*arrays)
        elif len(splats.centres):
            self.splats = self._server.scene.add_gaussian_splats(_node("Map", "splats"), *arrays)

    def _show_path(self, state: SlamState, trajectory: Trajectory) -> None:
        """The path, with no line from one map to another."""
        maps = maps_of(state.graph)[state.log.keyframes]
        lines = _consecutive(trajectory.positions)[np.diff(maps) == 0]
        self._lines("Path", lines, _PATH_COLOUR, thickness=3.0)

    def _show_uncertainty(self, trajectory: Trajectory, covariances: Float[np.ndarray, "n 6 6"]) -> None:
        """Ellipsoids of three standard deviations around places spread over the path."""
        number = min(len(trajectory), _MOST_ELLIPSOIDS)
        rows = np.unique(np.linspace(len(trajectory) - 1, 0, number).round().astype(int))
        rotations = trajectory.poses[rows, :3, :3]
        variances, axes = np.linalg.eigh(rotations @ covariances[rows, :3, :3] @ rotations.swapaxes(1, 2))
        axes[..., 0] *= np.linalg.det(axes)[:, None]
        sigmas = np.sqrt(np.maximum(variances, 0))
        sphere = trimesh.creation.icosphere(subdivisions=2)
        self._ellipsoids = self._server.scene.add_batched_meshes_simple(
            _node("Uncertainty", "ellipsoids"),
            np.asarray(sphere.vertices, np.float32),
            np.asarray(sphere.faces, np.uint32),
            batched_wxyzs=quaternions_from_rotations(axes),
            batched_positions=trajectory.positions[rows],
            batched_scales=_SIGMAS * self._magnification * sigmas,
            batched_colors=_PATH_COLOUR,
            opacity=0.35,
            lod="off",
            cast_shadow=False,
            receive_shadow=False,
        )

    def _show_keyframes(self, state: SlamState) -> None:
        first: dict[int, View] = {}
        for view in state.mapping.views:
            first.setdefault(view.keyframe, view)
        poses = se3.matrices_of(state.graph.poses)
        for number, view in first.items():
            motion = np.asarray(view.T_keyframe_cam.wxyz_xyz)[None]
            pose = poses[number] @ se3.matrices_of(motion)[0]
            if number not in self.keyframes:
                name = _node("Keyframes", str(number))
                self.keyframes[number] = self._frustum(
                    name, state.camera, _KEYFRAME_COLOUR, 0.08, _thumbnail(view)
                )
            _place(self.keyframes[number], pose)

    def _frustum(
        self,
        name: str,
        camera: Camera,
        colour: tuple[int, int, int],
        scale: float,
        image: UInt8[np.ndarray, "h w 3"] | None,
    ) -> viser.CameraFrustumHandle:
        return self._server.scene.add_camera_frustum(
            name,
            fov=vertical_field_of_view(camera),
            aspect=camera.width / camera.height,
            scale=scale,
            thickness=1.0 if image is not None else 3.0,
            thickness_units="screen",
            color=colour,
            image=image,
            jpeg_quality=70,
            cast_shadow=False,
            receive_shadow=False,
        )

    def _lines(
        self,
        layer: str,
        segments: Float[np.ndarray, "n 2 3"],
        colour: tuple[int, int, int],
        *,
        thickness: float = 2.0,
    ) -> None:
        self._server.scene.add_line_segments(
            _node(layer, "lines"),
            segments.astype(np.float32),
            colour,
            thickness=thickness,
            thickness_units="screen",
        )


def _node(layer: str, *path: str) -> str:
    """Name of a node; all layers but the map hang below one, which can hide them together."""
    parent = "/live" if layer == "Map" else _MARKS
    return "/".join([parent, layer, *path]).lower().replace(" ", "_")


def _place(frustum: viser.CameraFrustumHandle, pose: Float[np.ndarray, "4 4"]) -> None:
    frustum.wxyz = quaternions_from_rotations(pose[None, :3, :3])[0]
    frustum.position = pose[:3, 3]


def _consecutive(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 2 3"]:
    """Segments from each point to the next."""
    return np.stack([points[:-1], points[1:]], axis=1)


def _thumbnail(view: View) -> UInt8[np.ndarray, "h w 3"]:
    image = np.asarray(view.rgb)
    step = max(1, image.shape[1] // _THUMBNAIL_WIDTH)
    return np.ascontiguousarray(image[::step, ::step])


def _largest(gaussians: Gaussians, most: int) -> Gaussians:
    """The Gaussians with the most opacity times area, if there are more than `most`."""
    used = np.asarray(gaussians.valid)
    if used.sum() <= most:
        return gaussians
    scales = np.sort(np.asarray(gaussians.log_scales), axis=1)
    opacity = 1 / (1 + np.exp(-np.asarray(gaussians.opacity_logits)))
    covered = np.where(used, opacity * np.exp(scales[:, 1] + scales[:, 2]), -1)
    keep = np.zeros_like(used)
    keep[np.argpartition(covered, -most)[-most:]] = True
    return eqx.tree_at(lambda g: g.valid, gaussians, jnp.asarray(keep))
