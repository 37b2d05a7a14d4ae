"""The camera's path in the browser's scene: line, keyframes, uncertainty, the replayed frame."""

from collections.abc import Callable

import numpy as np
import trimesh
import viser
from jaxtyping import Float, UInt8

from sfgs_jax.geometry import Camera, Trajectory, quaternions_from_rotations
from sfgs_jax.viewer._viewpoints import vertical_field_of_view

# Without a recording and its intrinsics, frusta have the field of view of a common RGB-D camera.
_FIELD_OF_VIEW = np.radians(48)
_ASPECT = 4 / 3

_PATH_COLOUR, _KEYFRAME_COLOUR, _REPLAY_COLOUR = (37, 99, 235), (148, 163, 184), (220, 38, 38)
_ELLIPSOID_COLOUR = (245, 158, 11)

_INSIDE = 0.5
"""Distance to a pose, in lengths of a frustum, within which a browser looks from there."""

_MOST_ELLIPSOIDS = 400
"""Ellipsoids of a path; those of a longer one are spread evenly."""

ENLARGEMENTS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
"""Factors on three standard deviations."""


def field_of_view(camera: Camera | None) -> tuple[float, float]:
    """Vertical field of view in radians, and width over height of the image plane."""
    if camera is None:
        return float(_FIELD_OF_VIEW), _ASPECT
    aspect = camera.width * float(camera.fy) / (camera.height * float(camera.fx))
    return vertical_field_of_view(camera), aspect


def ellipsoids(
    poses: Float[np.ndarray, "n 4 4"], covariances: Float[np.ndarray, "n 6 6"]
) -> tuple[Float[np.ndarray, "n 3 3"], Float[np.ndarray, "n 3"]]:
    """Axes and standard deviations of camera positions.

    Args:
        poses: `T_world_cam`.
        covariances: of tangents that perturb the poses on the right, translation first.

    Returns:
        Rotations whose columns are the axes in the world, and standard deviations along them, metres.
    """
    rotations = poses[:, :3, :3]
    inside = covariances[:, :3, :3]
    variances, axes = np.linalg.eigh(rotations @ inside @ rotations.transpose(0, 2, 1))
    axes[..., 0] *= np.sign(np.linalg.det(axes))[:, None]
    return axes, np.sqrt(np.maximum(variances, 0))


class PathLayer:
    """Nodes of a path.

    Args:
        scene: of the server.
        trajectory: the path, at least one pose.
        keyframes: poses to mark; may be empty.
        camera: intrinsics; None if they are not known.
        covariances: of the path's poses; None if they are not known.

    Attributes:
        line: the path, `/trajectory/path`; None for a single pose.
        frusta: a camera frustum per keyframe, `/trajectory/keyframes/I`.
        replay: the frustum of the replayed frame, `/replay`.
        uncertainty: ellipsoids along the path, `/trajectory/uncertainty`; None without covariances.
        enlargement: factor on three standard deviations, at which the ellipsoids can be seen.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        trajectory: Trajectory,
        keyframes: Trajectory,
        camera: Camera | None,
        covariances: Float[np.ndarray, "n 6 6"] | None,
    ) -> None:
        self._scene, self._keyframes = scene, keyframes
        self._length = float(np.clip(0.02 * np.linalg.norm(np.ptp(trajectory.positions, axis=0)), 0.02, 0.15))
        self._wanted, self._inside = (True, True, False), False
        self.line = self._add_line(trajectory)
        fov, aspect = field_of_view(camera)
        self.frusta = self._add_frusta(fov, aspect)
        self.replay = scene.add_camera_frustum(
            "/replay",
            fov=fov,
            aspect=aspect,
            scale=2.5 * self._length,
            thickness=3.0,
            thickness_units="screen",
            color=_REPLAY_COLOUR,
        )
        self.enlargement = 1
        self.median_sigma = 0.0
        self.uncertainty = None if covariances is None else self._add_ellipsoids(trajectory, covariances)

    def on_keyframe(self, told: Callable[[int, viser.ClientHandle | None], None]) -> None:
        """Call a function with the index of a keyframe that somebody clicks, and the browser."""
        for i, frustum in enumerate(self.frusta):
            frustum.on_click(lambda event, i=i: told(i, event.client))

    def place_replay(self, T_world_cam: Float[np.ndarray, "4 4"]) -> None:
        """Put the replay's frustum at a pose."""
        self.replay.wxyz = quaternions_from_rotations(T_world_cam[None, :3, :3])[0]
        self.replay.position = T_world_cam[:3, 3]

    def show_picture(self, picture: UInt8[np.ndarray, "H W 3"] | None) -> None:
        """Show a picture in the replay's frustum, or none."""
        self.replay.image = picture

    def show(self, *, path: bool, keyframes: bool, uncertainty: bool) -> None:
        """Choose the parts that are shown, as long as nobody looks from the path."""
        self._wanted = (path, keyframes, uncertainty)
        self._show_wanted()

    def enlarge(self, factor: float) -> None:
        """Draw the ellipsoids at another multiple of three standard deviations."""
        if self.uncertainty is not None:
            self.uncertainty.batched_scales = (3 * factor * self._sigmas).astype(np.float32)

    def make_way(self, positions: Float[np.ndarray, "b 3"]) -> None:
        """Hide the path while a browser looks from one of its poses, because it would cover the view.

        Args:
            positions: of the browsers' cameras.
        """
        places = np.concatenate([self._keyframes.positions, np.asarray(self.replay.position)[None]])
        distances = np.linalg.norm(places[:, None] - positions[None], axis=2)
        inside = bool(np.any(distances < _INSIDE * self._length))
        if inside != self._inside:
            self._inside = inside
            self._show_wanted()

    def _show_wanted(self) -> None:
        path, keyframes, uncertainty = (wanted and not self._inside for wanted in self._wanted)
        if self.line is not None:
            self.line.visible = path
        if self.uncertainty is not None:
            self.uncertainty.visible = uncertainty
        for frustum in self.frusta:
            frustum.visible = keyframes
        self.replay.visible = not self._inside

    def _add_line(self, trajectory: Trajectory) -> viser.LineSegmentsHandle | None:
        positions = trajectory.positions.astype(np.float32)
        segments = np.stack([positions[:-1], positions[1:]], axis=1)
        if not len(segments):
            return None
        return self._scene.add_line_segments(
            "/trajectory/path", segments, _PATH_COLOUR, thickness=3.0, thickness_units="screen"
        )

    def _add_frusta(self, fov: float, aspect: float) -> list[viser.CameraFrustumHandle]:
        wxyz = quaternions_from_rotations(self._keyframes.poses[:, :3, :3])
        frusta = []
        for i, position in enumerate(self._keyframes.positions):
            frustum = self._scene.add_camera_frustum(
                f"/trajectory/keyframes/{i}",
                fov=fov,
                aspect=aspect,
                scale=self._length,
                thickness=1.5,
                thickness_units="screen",
                color=_KEYFRAME_COLOUR,
                variant="filled",
                wxyz=wxyz[i],
                position=position,
            )
            frusta.append(frustum)
        return frusta

    def _add_ellipsoids(
        self, trajectory: Trajectory, covariances: Float[np.ndarray, "n 6 6"]
    ) -> viser.BatchedMeshHandle:
        count = len(trajectory)
        chosen = np.unique(np.linspace(0, count - 1, min(count, _MOST_ELLIPSOIDS)).round().astype(int))
        axes, self._sigmas = ellipsoids(trajectory.poses[chosen], covariances[chosen])
        self.median_sigma = float(np.median(self._sigmas[:, 2]))
        wanted = self._length / max(3 * self.median_sigma, 1e-9)
        self.enlargement = max((step for step in ENLARGEMENTS if step <= wanted), default=1)
        ball = trimesh.creation.icosphere(subdivisions=2)
        return self._scene.add_batched_meshes_simple(
            "/trajectory/uncertainty",
            np.asarray(ball.vertices, np.float32),
            np.asarray(ball.faces, np.uint32),
            batched_wxyzs=quaternions_from_rotations(axes).astype(np.float32),
            batched_positions=trajectory.positions[chosen].astype(np.float32),
            batched_scales=(3 * self.enlargement * self._sigmas).astype(np.float32),
            batched_colors=_ELLIPSOID_COLOUR,
            opacity=0.35,
            cast_shadow=False,
            receive_shadow=False,
            visible=False,
        )
