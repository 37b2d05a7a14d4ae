"""Settings of the keyframe graph: its registrations, its adjustment, and its loops."""

import math
from dataclasses import dataclass

from sfgs_jax.arrays import check_counts, check_positive, check_range


@dataclass(frozen=True)
class GraphConfig:
    """Graph of keyframes: registrations between them, adjustment with their landmarks, and loop closure."""

    enabled: bool = True
    """Whether there is a graph. Without it keyframes stay where they were tracked, and no loop closes."""
    num_neighbours: int = 5
    """Earlier keyframes with the same view that a new one is registered to, the nearest first."""
    neighbour_distance: float = 1.0
    """Largest distance of a neighbour, metres."""
    neighbour_angle: float = 0.6
    """Largest angle between the viewing directions of neighbours, radians."""
    max_correction: float = 0.1
    """Largest disagreement between a neighbour's registration and the graph, metres and radians. A larger
    one is rejected as an edge, and examined as a loop."""
    return_to_keyframes: bool = True
    """Whether tracking returns to a keyframe from before where a new one would add nothing. While the
    distortion of depth is estimated it never does, since every new keyframe tells more about that."""
    edge_sigma_metres: float = 0.002
    """Standard deviation of a registration's systematic error, metres, until cycles of edges tell it."""
    edge_sigma_radians: float = 0.0015
    """Standard deviation of a registration's systematic error, radians, until cycles of edges tell it."""
    registrations_per_frame: int = 1
    """Registrations between keyframes after each frame. Few of them keep every frame on time."""
    backlog: int = 10
    """Waiting registrations for which one more is done after a frame."""
    kernel_width: float = 3.0
    """Width of a registration's Huber kernel, standard deviations."""
    window: int = 60
    """Keyframes that are adjusted together, with their landmarks; 0 leaves the landmarks out."""
    adjustment_frames: int = 4
    """Frames after which an adjustment's results are taken; meanwhile they are computed."""
    max_landmarks: int = 4096
    """Landmarks that are adjusted; each keyframe has its share, those it has in common with most others."""
    loops: bool = True
    """Whether loops are closed."""
    loop_candidates: int = 2
    """Keyframes outside the neighbourhood that are tried as loops, the most similar images first."""
    loop_similarity: float = 0.75
    """Least cosine between the image signatures of a loop."""
    loop_gap: int = 10
    """Newest keyframes that are never loops."""
    loop_inliers: int = 40
    """Least keypoint inliers of a loop."""
    loop_inlier_fraction: float = 0.4
    """Least share of surface inliers of a loop."""
    loop_support: int = 2
    """Loops that must agree with each other before they are accepted."""
    max_loop_candidates: int = 16
    """Candidate loops that wait for others to agree with them; the oldest make room."""
    loop_slack: float = 0.3
    """Correction that any loop may make, metres."""
    max_drift: float = 0.08
    """Correction that a loop may make beyond the slack, as a share of the path since. A larger one marks
    another place that looks the same."""
    max_turn: float = 0.35
    """Largest rotation that a loop may correct, radians."""
    relocalisation_candidates: int = 4
    """Keyframes that a lost frame is looked for in, the most similar images first."""
    relocalisation_inliers: int = 30
    """Least keypoint inliers with which a lost frame is found again in a keyframe."""
    relocalisation_distance: float = 0.3
    """Distance from its last pose within which a lost frame is believed at once, metres."""
    relocalisation_speed: float = 2.0
    """Speed at which that distance grows while the camera is lost, m/s: a quick walk."""
    relocalisation_frames: int = 5
    """Frames in a row that have to be found at one place before they are believed beyond that distance."""
    new_map_frames: int = 30
    """Frames with keypoints that fit no known place, after which a lost camera begins another map; 0 never
    begins one. Fewer do where it leaves a small map: `relocalisation_frames` for each keyframe. Maps become
    one when a place of both is recognised."""
    map_support: int = 5
    """Loops between two maps that must agree before the maps become one, at most `max_loop_candidates`.
    Nothing else tells where the maps lie to each other."""
    capacity: int = 128
    """Keyframes that the solver has room for at first. It doubles when full."""

    def __post_init__(self) -> None:
        """Refuse values that have no meaning."""
        check_counts(
            self, 1, "registrations_per_frame", "backlog", "max_landmarks", "loop_support", "map_support"
        )
        check_counts(self, 2, "capacity")
        check_counts(self, self.loop_support, "max_loop_candidates")
        check_counts(
            self,
            0,
            "num_neighbours",
            "window",
            "adjustment_frames",
            "loop_candidates",
            "loop_gap",
            "loop_inliers",
        )
        check_counts(self, 0, "relocalisation_candidates", "relocalisation_inliers", "new_map_frames")
        check_counts(self, 1, "relocalisation_frames")
        check_range(self, 0, math.inf, "relocalisation_distance", "relocalisation_speed")
        check_positive(self, "edge_sigma_metres", "edge_sigma_radians", "kernel_width")
        check_range(self, 0, math.inf, "neighbour_distance", "neighbour_angle", "max_correction")
        check_range(self, 0, math.inf, "loop_slack", "max_drift", "max_turn")
        check_range(self, -1, 1, "loop_similarity")
        check_range(self, 0, 1, "loop_inlier_fraction")
