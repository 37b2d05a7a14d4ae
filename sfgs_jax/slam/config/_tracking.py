"""Settings of tracking: keypoints, surface, the judgement of a pose, and when a keyframe is taken."""

import math
from dataclasses import dataclass, field
from typing import Literal, get_args

from sfgs_jax.arrays import InputError, check_choice, check_counts, check_positive, check_range
from sfgs_jax.gicp import GicpConfig
from sfgs_jax.superfeats import MIN_SIMILARITY

KeypointKind = Literal["superfeats", "orb", "none"]
MatchWeights = Literal["equal", "learned"]


@dataclass(frozen=True)
class FeaturesConfig:
    """Keypoints, their matches, and the motion found from them."""

    kind: KeypointKind = "superfeats"
    """Keypoint detector and descriptor; `none` leaves tracking to GICP alone."""
    max_keypoints: int = 1024
    """Slots for the keypoints of a frame."""
    min_similarity: float = MIN_SIMILARITY
    """Least cosine between the descriptors of a match."""
    guidance: float = 0.2
    """Similarity that a match far from where the motion is expected to bring it loses against its rivals.
    Texture that repeats itself, such as tiles, is told apart by this alone. 0 matches by looks alone."""
    guidance_reach: float = 0.25
    """Distance from which on a match loses all of that, as a share of the image's width."""
    match_weights: MatchWeights = "equal"
    """Weights of the matches in a motion. With `equal`, all matches weigh the same. With `learned`, a match
    weighs by how far its similarity exceeds the floor, and by its keypoints' scores. Then a pose has
    gradients to descriptors and scores."""
    min_contrast: float = 0.015
    """Least second difference of the grey values, of 1, around a keypoint. It removes the artefacts that a
    detector finds on walls without texture and in the dark; even shading has none."""
    depth_tolerance: float = 0.03
    """Largest bend of the surface around a keypoint, as a share of its depth. Beyond it the keypoint lies on
    a depth edge, and its depth is not used."""
    max_rigid_matches: int = 256
    """Best matches that the first, rigid motion is found from."""
    max_distance: float = 0.08
    """Largest distance between the points of a match under the rigid motion, metres."""
    align_patches: bool = True
    """Whether matches get the places at which the images around them look alike, to a tenth of a pixel.
    Without it they keep those of the detector, good to half of one."""
    min_patch_agreement: float = 0.9
    """Least correlation of the images around the keypoints of a match, as the motion by all matches lays them
    over each other. Below it they show different things that look alike."""
    patch_steps: int = 6
    """Steps to these places. The last two say whether there is one."""
    pixel_sigma: float = 1.0
    """Standard deviation of a keypoint's position as detected, pixels."""
    patch_sigma: float = 0.5
    """Standard deviation of a match's position by `align_patches`, pixels."""
    patch_kernel_width: float = 4.5
    """Width of the Geman-McClure kernel of a match by `align_patches`, standard deviations. Views that have
    changed much need a wide one."""
    inverse_depth_sigma: float = 0.003
    """Standard deviation of a keypoint's inverse depth, 1/m."""
    kernel_width: float = 3.0
    """Width of the Geman-McClure kernel of a match as detected, and of a landmark in a keyframe, standard
    deviations."""
    max_iterations: int = 30
    """Most steps to the motion with the least reprojection error; mostly ten are enough."""
    tolerance: float = 1e-5
    """Length of a step, metres and radians, below which that motion is found."""
    inlier_pixels: float = 3.0
    """Largest reprojection error of an inlier, pixels."""
    inlier_depth_sigmas: float = 6.0
    """Largest error of an inlier's inverse depth, standard deviations."""
    correlation: float = 4.0
    """Number of matches that share one independent error. Keypoints close to each other err together."""
    min_inliers: int = 10
    """Least inliers with which the keypoints take part in a registration."""
    min_inliers_alone: int = 20
    """Least inliers with which the keypoints stand without the surface, or against it."""
    min_inlier_share: float = 0.25
    """Least share of inliers among the matches with which the keypoints take part in a registration. Less is
    enough where `min_inlier_share_sure` of those around which the images agree are inliers."""
    min_inlier_share_alone: float = 0.33
    """Least share of inliers, beside `min_inliers_alone`, where the surface leaves a direction of motion
    free. There the keypoints decide alone, and nothing would contradict wrong matches that agree."""
    min_inlier_share_sure: float = 0.5
    """Least share of inliers with which the keypoints are sure. Unsure ones need a surface that
    agrees, and `max_velocity_change` bounds their motion: where things look alike, matches of a wrong place
    agree too. A lost camera may be anywhere. Then such a share of those that look alike, at least
    `min_inliers_alone`, and the surface have to agree."""

    def __post_init__(self) -> None:
        """Refuse values that have no meaning."""
        check_choice(self, "kind", get_args(KeypointKind))
        check_choice(self, "match_weights", get_args(MatchWeights))
        check_counts(self, 1, "max_keypoints", "max_rigid_matches", "max_iterations")
        check_counts(self, 2, "patch_steps")
        check_counts(self, 1, "min_inliers", "min_inliers_alone")
        check_range(self, 0, 2, "guidance")
        check_range(self, 0, 1, "min_similarity", "min_contrast", "min_inlier_share", "min_patch_agreement")
        check_range(self, 0, 1, "min_inlier_share_alone", "min_inlier_share_sure")
        check_positive(
            self, "depth_tolerance", "max_distance", "pixel_sigma", "patch_sigma", "inverse_depth_sigma"
        )
        check_positive(self, "patch_kernel_width", "tolerance")
        check_positive(
            self, "guidance_reach", "kernel_width", "inlier_pixels", "inlier_depth_sigmas", "correlation"
        )

    @property
    def matched_sigma(self) -> float:
        """Standard deviation of a match's position, pixels, once it is known as well as it will be."""
        return self.patch_sigma if self.align_patches else self.pixel_sigma

    @property
    def matched_kernel_width(self) -> float:
        """Width of the kernel of a match whose place is known as well as it will be."""
        return self.patch_kernel_width if self.align_patches else self.kernel_width


@dataclass(frozen=True)
class TrackingConfig:
    """Pose of a frame: keypoints and GICP against the reference keyframe."""

    features: FeaturesConfig = field(default_factory=FeaturesConfig)
    """Keypoints."""
    gicp: GicpConfig = field(default_factory=lambda: GicpConfig(strides=(3, 2, 1, 1)))
    """GICP. Its finest level takes every third row and column. Every second one gives the same poses to the
    millimetre and takes half as long again (`experiments.tracking`)."""
    use_surface: bool = True
    """Whether GICP takes part. Without it keypoints alone give the poses."""
    num_references: int = 2
    """Keyframes that the tracker holds. Frames are registered to the newest of them."""
    estimate_timing: bool = False
    """Whether each row of an image moves with the camera. The times of the rows, of rolling shutters and of
    depth that is late, are estimated while tracking."""
    delay_sigma: float = 0.01
    """Standard deviation of the time from colour's exposure to depth's, as known before the first frame,
    seconds. The two streams of most cameras are at most half a frame apart."""
    readout_sigma: float = 0.02
    """Standard deviation of the time that a rolling shutter takes for an image, as known before the first
    frame, seconds. Global shutters take none, slow ones the whole time between two frames."""
    estimate_depth: bool = False
    """Whether depth is corrected by an error of inverse depth that is smooth over the image and the same in
    all frames. The error is estimated from the registrations between keyframes."""
    depth_sigma: float = 0.005
    """Standard deviation of the error of inverse depth, as known before the first frame, 1/m."""
    depth_tilt_sigma: float = 0.01
    """Standard deviation of the part of that error that is linear over the image, at its borders, 1/m."""
    depth_step_sigma: float = 0.0025
    """Standard deviation of the change of that error over a sixteenth of the image, as known before the first
    frame, 1/m."""
    estimate_extrinsic: bool = False
    """Whether `estimate_depth` also finds where the depth camera is beside the colour camera, if it is one of
    its own. The turn about the axis that the camera itself turns about shows least."""
    extrinsic_shift_sigma: float = 0.01
    """Standard deviation of the depth camera's position along each axis, as known before the first frame,
    metres."""
    extrinsic_turn_sigma: float = 0.01
    """Standard deviation of the depth camera's rotation about each axis, likewise, radians."""
    motion_model_sigma: float = 0.1
    """Standard deviation of the constant-velocity motion model, metres and radians."""
    min_inlier_fraction: float = 0.3
    """Least share of surface inliers that GICP needs to succeed, but for points at holes of the reference."""
    min_inlier_fraction_alone: float = 0.4
    """Least share of surface inliers where no keypoints confirm GICP. Surfaces alone fit in many places."""
    min_agreement: float = 0.75
    """Least share of surface inliers among the points that the reference shows, where no keypoints confirm
    GICP for sure. After lost or missing frames the camera may be anywhere. Then half as many may disagree."""
    min_image_correlation: float = 0.9
    """Least correlation of the two images, a median over blocks, where the keypoints are not sure. Images
    tell a place from one whose keypoints and surface look like it. After lost or missing frames half as much
    may differ. Frames are asked once one before them has looked like its reference. 0 asks none."""
    max_velocity_change: float = 2.0
    """Largest change of the camera's velocity since the last tracked frame where the keypoints are not sure,
    m/s. A place that only looks like the right one is seldom so near the prediction. Before the second frame,
    and after one found by its looks, no velocity is known, and images have to look alike instead."""
    max_correction_alone: float = 0.3
    """Largest distance between GICP's start and its end where no keypoints confirm it, metres and radians."""
    search_angle: float = 0.2
    """Angle by which the guesses for a lost frame are turned up, down and sideways, radians. GICP converges
    from starts about this far off."""
    max_disagreement: float = 0.1
    """Largest difference between the motions of keypoints and GICP that counts as agreement, metres and
    radians."""
    max_motion_model_frames: int = 15
    """Frames in a row whose pose may rest on the motion model along a direction that the surface leaves
    free."""
    max_motion_model_travel: float = 0.1
    """Motion that the motion model may add up to over such frames, metres and radians."""
    max_lost: int = 30
    """Lost frames in a row after which the surface alone finds no frame again. The camera may be anywhere by
    then, and surfaces fit in many places. Without keypoints there is no limit."""
    max_position_sigma: float = 0.05
    """Standard deviation of a frame's position in its keyframe beyond which the frame is lost, metres. The
    motion model alone is less certain than the default, which tells nearly every pose to 10 cm."""
    max_scale_change: float = 0.03
    """Largest change of the scale of depth from the reference to a frame, as a share, that is taken for the
    distortion of the sensor. With a larger one a frame is lost: the sensor has changed its unit."""
    max_depth_lag: int = 1
    """Frames by which depth may come late or early against colour. Beyond it frames are lost, for their depth
    is of another time. Below it the motion in that time counts in a pose's covariance, as far as
    `estimate_timing` has not found it. With 5 or more no lag is looked for."""
    max_focal_error: float = 0.015
    """Largest error of the focal lengths, as a share, with which frames are believed. If the keyframes show a
    larger one, chance allowed for, frames are lost: their poses would drift, and fit as well as ever. They
    show three quarters of it. 1 looks for none."""
    max_depth_scatter: float = 0.01
    """Largest scatter of depth from pixel to pixel, as a share of it, up to 2.5 metres. Farther off it grows
    with the square of depth. Depth that scatters more is noise, and is not used."""
    keyframe_inlier_fraction: float = 0.7
    """Share of surface inliers below which a new keyframe is taken."""
    keyframe_margin: float = 1.5
    """Keypoint inliers below which a new keyframe is taken, as a multiple of the least number and the least
    share with which keypoints are believed."""
    keyframe_translation: float = 0.3
    """Distance from the reference beyond which a new keyframe is taken, metres."""
    keyframe_rotation: float = 0.35
    """Angle from the reference beyond which a new keyframe is taken, radians."""

    def __post_init__(self) -> None:
        """Refuse values that have no meaning."""
        # One frame may bring two keyframes.
        check_counts(self, 2, "num_references")
        check_counts(self, 0, "max_motion_model_frames", "max_lost", "max_depth_lag")
        check_positive(self, "motion_model_sigma", "delay_sigma", "readout_sigma")
        check_positive(self, "max_scale_change", "max_focal_error", "max_depth_scatter")
        check_positive(self, "max_position_sigma")
        check_positive(self, "depth_sigma", "depth_step_sigma", "depth_tilt_sigma")
        check_positive(self, "extrinsic_shift_sigma", "extrinsic_turn_sigma")
        if self.estimate_extrinsic and not self.estimate_depth:
            raise InputError("`estimate_extrinsic` needs `estimate_depth`, of which it is a part.")
        check_range(self, 0, 1, "min_inlier_fraction", "min_inlier_fraction_alone", "min_agreement")
        check_range(self, 0, 1, "min_image_correlation")
        check_range(self, 0, 1, "keyframe_inlier_fraction")
        check_positive(self, "max_velocity_change")
        check_range(self, 0, math.inf, "max_correction_alone", "search_angle", "max_disagreement")
        check_range(self, 0, math.inf, "keyframe_margin")
        check_range(self, 0, math.inf, "max_motion_model_travel", "keyframe_translation", "keyframe_rotation")
