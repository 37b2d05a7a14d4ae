"""The keyframe graph: keyframes as nodes, registrations between them as edges."""

from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Float, Int

from sfgs_jax.arrays import Text, printed_fields, printed_length, pytree
from sfgs_jax.gicp import RowMotion
from sfgs_jax.sensors import SensorTiming
from sfgs_jax.slam.state._depth_information import DepthInformation, no_depth_information
from sfgs_jax.slam.state._focal_information import FocalInformation
from sfgs_jax.slam.state._frame_features import FrameFeatures
from sfgs_jax.slam.state._registration import Registration


@pytree
@dataclass(frozen=True, eq=False)
class Keyframe:
    """A frame that others are registered to.

    Attributes:
        features: its surface and keypoints.
        landmarks: (K,) number of the landmark that each keypoint shows, -1 where it shows none.
        frame: number of the frame in its source.
        reference: number of the keyframe that it was tracked in; its own for the first of a map.
        T_reference_keyframe: (7,) pose that it was tracked at there, as wxyz_xyz.
        depth_parameters: (G,) of the depth correction that the features have; none if depth is not
            corrected. See `DepthCorrection.vector`.
        twist: (6,) motion per second while it was read, in its camera; zeros if unknown.
        times: (3,) of its rows by which the features were rectified, in the order of `SensorTiming`; seconds.
        edition: how often they were rectified anew.
    """

    features: FrameFeatures
    landmarks: Int[np.ndarray, " k"]
    frame: int
    reference: int
    T_reference_keyframe: Float[np.ndarray, "7"]
    depth_parameters: Float[np.ndarray, " G"]
    twist: Float[np.ndarray, "6"]
    times: Float[np.ndarray, "3"]
    edition: int

    def __repr__(self) -> str:
        return printed_fields("Keyframe", frame=self.frame, reference=self.reference)

    @property
    def motion(self) -> RowMotion:
        """Motion of its rows, by which the features were rectified."""
        known = np.asarray(self.twist.any() and self.times.any())
        return RowMotion(jnp.asarray(self.twist), SensorTiming(*self.times), jnp.asarray(known))


@pytree
@dataclass(frozen=True, eq=False)
class Edge:
    """A registration of one keyframe to another, on the host.

    Attributes:
        target: number of the keyframe registered to.
        source: number of the keyframe registered, the later one.
        T_target_source: (7,) the motion found, as wxyz_xyz.
        information: (6, 6) of its tangent, by surface and keypoints, as if all residuals erred on their own.
        surface_motion: (7,) the motion by the surface alone.
        surface_information: (6, 6) of its tangent, likewise.
        revisit: whether it ties a place seen again to the keyframes from before, however small the drift.
        loop: whether it was accepted by its consistency with other loops.
        depth_parameters: (G,) of the depth correction that it was found with.
        sensitivity: (6, G) derivative of the motion's tangent by them.
        surface_sensitivity: (6, G) derivative of the surface's motion by them.
        told: whether the estimates of the camera's errors have heard it.
    """

    target: int
    source: int
    T_target_source: Float[np.ndarray, "7"]
    information: Float[np.ndarray, "6 6"]
    surface_motion: Float[np.ndarray, "7"]
    surface_information: Float[np.ndarray, "6 6"]
    revisit: bool
    loop: bool
    depth_parameters: Float[np.ndarray, " G"]
    sensitivity: Float[np.ndarray, "6 G"]
    surface_sensitivity: Float[np.ndarray, "6 G"]
    told: bool = False


@pytree
@dataclass(frozen=True, eq=False)
class TrackedPair:
    """A keyframe with the one it was tracked in, whose edge the estimates of the camera are still to hear.

    Attributes:
        target: number of the keyframe that it was tracked in.
        source: number of the keyframe.
        found: the registration that it was tracked by.
    """

    target: int
    source: int
    found: Registration


@pytree
@dataclass(frozen=True, eq=False)
class EdgeNoise:
    """Error of edges beyond their information, and how often they say the same.

    Attributes:
        covariance: (6, 6) of an edge's tangent, by errors that all its residuals have in common.
        redundancy: edges per motion from one keyframe to the next. The images of n keyframes hold n - 1
            independent motions, however many pairs of them are registered.
    """

    covariance: Float[np.ndarray, "6 6"]
    redundancy: float

    def share(self, information: Float[np.ndarray, "n 6 6"]) -> Float[np.ndarray, "n 6 6"]:
        """Information that each of n edges adds to that of the others.

        Args:
            information: as if all residuals erred on their own.
        """
        # (I^-1 + S)^-1 without the inverse of I, which is singular where the surface leaves directions free.
        told = information.astype(np.float64)
        total = np.linalg.solve(np.eye(6) + told @ self.covariance, told)
        return (total + np.swapaxes(total, 1, 2)) / (2 * self.redundancy)


@pytree
@dataclass(frozen=True, eq=False)
class Landmarks:
    """Places of the landmarks, each in a keyframe, with which it moves.

    Attributes:
        keyframes: (L,) number of the keyframe; -1 for a landmark whose depth nobody has measured.
        points: (L, 3) in the camera of that keyframe, metres.
    """

    keyframes: Int[np.ndarray, " L"]
    points: Float[np.ndarray, "L 3"]

    def __len__(self) -> int:
        """Landmarks numbered so far."""
        return len(self.keyframes)


@pytree
@dataclass(frozen=True, eq=False)
class Adjustment:
    """Results of an adjustment of n keyframes, some of them with their landmarks.

    Attributes:
        poses: (n, 7) poses found, as wxyz_xyz.
        members: (w,) numbers of the keyframes that were adjusted with their landmarks.
        anchor: place among them of the keyframe that the covariances are relative to.
        covariances: (w, 6, 6) of the tangents of their poses, as if the anchor were known.
        landmarks: (l,) numbers of the landmarks.
        points: (l, 3) landmarks found, world coordinates in metres.
    """

    poses: Float[np.ndarray, "n 7"]
    members: Int[np.ndarray, " w"]
    anchor: int
    covariances: Float[np.ndarray, "w 6 6"]
    landmarks: Int[np.ndarray, " l"]
    points: Float[np.ndarray, "l 3"]


@jax.tree_util.register_pytree_with_keys_class
@dataclass(frozen=True, eq=False)
class PendingAdjustment:
    """An adjustment that a thread computes while the next frames are tracked.

    When its results are taken is counted in frames, so that a run repeats itself to the bit however fast the
    machine is. As a pytree it has the results' arrays: who asks for its leaves waits for them.

    Attributes:
        results: those, or what they will be.
        frames_left: frames until they are taken.
    """

    results: Adjustment | Future[Adjustment]
    frames_left: int

    def wait(self) -> Adjustment:
        """The results; it waits for them."""
        return self.results.result() if isinstance(self.results, Future) else self.results

    def tree_flatten_with_keys(self) -> tuple[tuple[tuple[Any, Any], ...], None]:
        """Children and their names, for JAX."""
        names = map(jax.tree_util.GetAttrKey, ("results", "frames_left"))
        return tuple(zip(names, (self.wait(), self.frames_left), strict=True)), None

    @classmethod
    def tree_unflatten(cls, _: None, children: tuple[Any, Any]) -> "PendingAdjustment":
        """From anything in place of the arrays, for JAX."""
        tree = object.__new__(cls)
        for name, child in zip(("results", "frames_left"), children, strict=True):
            object.__setattr__(tree, name, child)
        return tree


@pytree
@dataclass(frozen=True, eq=False)
class KeyframeGraph:
    """Keyframes, their poses, and the registrations between them.

    Attributes:
        keyframes: nodes, oldest first.
        poses: (n, 7) their `T_world_cam` as wxyz_xyz, on the host.
        covariances: (n, 6, 6) of the poses' tangents by errors that each registration has of its own, as if
            the first camera of their map were known.
        signatures: (n, D) of the keyframes' images, side by side for a search.
        edges: registrations that were accepted, in their order.
        noise: of the edges.
        num_absorbed: how many of them the poses hold already.
        tracked: newest keyframes with those they were tracked in; nothing but their equations is wanted.
        pending: pairs (target, source) still to be registered, the next one first.
        again: pairs with an edge that are to be registered anew once none is pending: their rows have moved.
        candidates: registrations that may be loops, and wait for others that agree.
        landmarks: places of the landmarks.
        adjustment: one that has been started and whose results have not been taken, if there is one.
        depth: what the registrations said about the distortion of depth.
        focal: what they said about the focal lengths.
        depth_parameters: (G,) of the depth correction that the poses are for.
        depth_covariance: (G, G) of these parameters.
        depth_sensitivities: (n, 6, G) derivatives of the poses' tangents by them, as if the first camera of
            their map were known.
        times_covariance: (3, 3) of the times of the rows as known at the newest keyframe, s²; zeros where
            they are not estimated.
    """

    keyframes: tuple[Keyframe, ...]
    poses: Float[np.ndarray, "n 7"]
    covariances: Float[np.ndarray, "n 6 6"]
    signatures: Float[np.ndarray, "n D"]
    edges: tuple[Edge, ...]
    noise: EdgeNoise
    num_absorbed: int
    tracked: tuple[TrackedPair, ...]
    pending: tuple[tuple[int, int], ...]
    again: tuple[tuple[int, int], ...]
    candidates: tuple[Edge, ...]
    landmarks: Landmarks
    adjustment: PendingAdjustment | None
    depth: DepthInformation
    focal: FocalInformation
    depth_parameters: Float[np.ndarray, " G"]
    depth_covariance: Float[np.ndarray, "G G"]
    depth_sensitivities: Float[np.ndarray, "n 6 G"]
    times_covariance: Float[np.ndarray, "3 3"]

    def __repr__(self) -> str:
        return printed_fields(
            "KeyframeGraph",
            keyframes=Text(printed_length(self.keyframes)),
            edges=Text(printed_length(self.edges)),
            loops=sum(bool(edge.revisit) for edge in self.edges or ()),
            landmarks=Text(printed_length(self.landmarks.points)),
        )

    @property
    def loops(self) -> tuple[Edge, ...]:
        """Edges that tie a place seen again to the keyframes from before."""
        return tuple(edge for edge in self.edges if edge.revisit)

    @property
    def has_waiting(self) -> bool:
        """True if a pair waits to be registered, or for its equations."""
        return bool(self.tracked or self.pending or self.again)

    def total_covariances(self, numbers: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k 6 6"]:
        """Covariances of some keyframes' poses, with the errors that all registrations have in common.

        Args:
            numbers: of the keyframes.
        """
        moved = self.depth_sensitivities[numbers]
        return self.covariances[numbers] + moved @ self.depth_covariance @ np.swapaxes(moved, 1, 2)

    def pose(self, number: int) -> jaxlie.SE3:
        """`T_world_cam` of a keyframe.

        Args:
            number: of the keyframe.
        """
        return jaxlie.SE3(self.poses[number])


def empty_graph(
    depth_parameters: Float[np.ndarray, " G"], noise: EdgeNoise, signature_size: int
) -> KeyframeGraph:
    """The graph before the first keyframe.

    Args:
        depth_parameters: (G,) of the depth correction to start from; none if depth is not corrected.
        noise: of the edges to come.
        signature_size: D of an image's signature.
    """
    return KeyframeGraph(
        keyframes=(),
        poses=np.zeros((0, 7), np.float32),
        covariances=np.zeros((0, 6, 6)),
        signatures=np.zeros((0, signature_size), np.float32),
        edges=(),
        noise=noise,
        num_absorbed=0,
        tracked=(),
        pending=(),
        again=(),
        candidates=(),
        landmarks=Landmarks(np.zeros(0, int), np.zeros((0, 3))),
        adjustment=None,
        depth=no_depth_information(depth_parameters),
        focal=FocalInformation(),
        depth_parameters=depth_parameters,
        depth_covariance=np.zeros(2 * depth_parameters.shape),
        depth_sensitivities=np.zeros((0, 6, len(depth_parameters))),
        times_covariance=np.zeros((3, 3)),
    )
