"""Places that a lost frame is believed at: within reach of its last pose, or confirmed by several frames."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from sfgs_jax.geometry import se3
from sfgs_jax.slam.config import GraphConfig
from sfgs_jax.slam.state._registration import Registration
from sfgs_jax.slam.state._tracker import Suspicion

NO_SUSPICION = Suspicion(
    np.asarray([1, 0, 0, 0, 0, 0, 0], np.float32), np.asarray(0, np.int32), np.asarray(0, np.int32)
)


def is_reachable(
    pose: Float[np.ndarray, "7"], last: Float[np.ndarray, "7"], seconds: float, config: GraphConfig
) -> bool:
    """True if the camera can have moved from one pose to another in the time between them.

    Args:
        pose: `T_world_cam` as wxyz_xyz.
        last: the same, earlier.
        seconds: between them; 0 if unknown.
        config: settings.
    """
    reach = config.relocalisation_distance + config.relocalisation_speed * seconds
    return bool(np.linalg.norm(pose[4:] - last[4:]) <= reach)


def undisputed(places: Sequence[tuple[Float[np.ndarray, "7"], Registration]], tolerance: float) -> int | None:
    """Number of the place with the most inliers; None without one that is certain enough.

    Another keyframe has to put the camera there too, and none may put it elsewhere with half as many inliers.

    Args:
        places: pose of the camera by each keyframe that a frame fits to, as wxyz_xyz, and the registration.
        tolerance: difference of poses that counts as the same, metres and radians.
    """
    if len(places) < 2:
        return None
    inliers = np.asarray([int(found.matched.num_inliers) for _, found in places])
    best = int(np.argmax(inliers))
    T = se3.matrices_of(np.stack([pose for pose, _ in places]))
    off = se3.logs_of(np.linalg.inv(T[best]) @ T)
    same = np.maximum(np.linalg.norm(off[:, :3], axis=1), np.linalg.norm(off[:, 3:], axis=1)) < tolerance
    disputed = (inliers[~same] > inliers[best] / 2).any()
    return None if same.sum() < 2 or disputed else best


def strengthened(
    suspicion: Suspicion, pose: Float[np.ndarray, "7"], seconds: float, config: GraphConfig
) -> Suspicion:
    """The suspicion after a frame was found at a place: one frame more, or begun anew if it was elsewhere.

    Args:
        suspicion: before the frame.
        pose: where it was found, `T_world_cam` as wxyz_xyz.
        seconds: since the frame before; 0 if unknown.
        config: settings.
    """
    before = int(suspicion.frames)
    agrees = before > 0 and is_reachable(pose, np.asarray(suspicion.pose), seconds, config)
    frames = np.asarray(before + 1 if agrees else 1, np.int32)
    return Suspicion(np.asarray(pose, np.float32), frames, np.asarray(0, np.int32))
