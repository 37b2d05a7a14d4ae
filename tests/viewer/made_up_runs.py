"""A run as an observer sees it, without tracking and mapping: true poses, and a map of one frame."""

from collections.abc import Iterator
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from sfgs_jax import slam
from sfgs_jax.datasets import SyntheticRecording
from sfgs_jax.geometry import Frame, se3
from sfgs_jax.gicp import GicpConfig
from sfgs_jax.slam import SlamState, View
from sfgs_jax.slam.frontend import feature_shapes
from sfgs_jax.slam.state import Edge, Keyframe
from sfgs_jax.splatting import Gaussians, rgb_to_sh

SIGMA_M = 0.01


def gaussians_of(recording: SyntheticRecording, frame: Frame) -> Gaussians:
    """A small opaque Gaussian for every pixel, in the frame's camera."""
    camera = recording.camera
    depth = np.asarray(frame.depth).reshape(-1)
    rays = (np.asarray(camera.pixels()) - np.asarray([camera.cx, camera.cy])) / float(camera.fx)
    points = depth[:, None] * np.concatenate([rays.reshape(-1, 2), np.ones((len(depth), 1))], axis=1)
    sizes = 0.6 * np.maximum(depth, 0.1) / float(camera.fx)
    return Gaussians(
        means=jnp.asarray(points, jnp.float32),
        quaternions=jnp.tile(jnp.asarray([1.0, 0, 0, 0]), (len(depth), 1)),
        log_scales=jnp.asarray(np.tile(np.log(sizes)[:, None], (1, 3)), jnp.float32),
        opacity_logits=jnp.asarray(np.full(len(depth), 3), jnp.float32),
        sh=rgb_to_sh(jnp.asarray(frame.rgb).reshape(-1, 3))[:, None],
        valid=jnp.asarray(depth > 0),
    )


def first_state(recording: SyntheticRecording) -> SlamState:
    """Two keyframes at one place with a loop between them, and the map of the first frame."""
    config = slam.SlamConfig()
    gicp = replace(GicpConfig(), levels=1, strides=(1,))
    config = replace(config, tracking=replace(config.tracking, gicp=gicp))
    config = replace(config, mapping=replace(config.mapping, pair_capacity=65_536, final_steps=3))
    state, frame = slam.init(recording.camera, config), recording[0]
    identity, still = np.asarray(se3.identity().wxyz_xyz), np.zeros(6, np.float32)
    keyframe = Keyframe(
        feature_shapes(state.params), np.full(4, -1), 0, 0, identity, np.zeros(0), still, still[:3], 0
    )
    information, offsets, free = np.eye(6), np.zeros(0), np.zeros((6, 0))
    loop = Edge(0, 1, identity, information, identity, information, True, True, offsets, free, free)
    graph = replace(
        state.graph,
        keyframes=(keyframe, keyframe),
        poses=np.stack([identity, identity]),
        covariances=np.tile(SIGMA_M**2 * np.eye(6), (2, 1, 1)),
        depth_sensitivities=np.zeros((2, 6, 0)),
        signatures=np.zeros((2, state.graph.signatures.shape[1]), np.float32),
        edges=(loop,),
    )
    rgb = np.round(255 * np.asarray(frame.rgb)).astype(np.uint8)
    depth = np.asarray(frame.depth)
    view = View(rgb, depth, depth > 0, still, 0, se3.identity(), 0, np.ones(3, np.float32), still, False)
    gaussian_map = eqx.tree_at(lambda m: m.gaussians, state.mapping.map, gaussians_of(recording, frame))
    mapping = replace(state.mapping, map=gaussian_map, views=(view,), keyframe_poses=graph.poses)
    return replace(state, graph=graph, mapping=mapping)


def progress_of(recording: SyntheticRecording, state: SlamState) -> Iterator[slam.Progress]:
    """Reports on the frames of a recording to an observer, from a first state on."""
    run = slam.Run(state)
    truth = np.linalg.inv(recording.ground_truth.poses[0]) @ recording.ground_truth.poses
    for number in range(len(recording)):
        frame = recording[number]
        pose, covariance = se3.from_matrix(truth[number]), SIGMA_M**2 * np.eye(6)
        with run.stopwatch("frame"), run.stopwatch("tracking"):
            log = run.state.log.with_frame(frame.timestamp, number, 0, pose, covariance)
        run.state = replace(run.state, log=log, next_frame=number + 1)
        run.num_frames = number + 1
        info = slam.StepInfo(
            T_world_cam=pose,
            covariance=covariance,
            tracked=True,
            source=slam.PoseSource.JOINT,
            relocalised=False,
            new_keyframe=False,
            new_map=False,
            new_view=False,
            loop_closed=False,
            inlier_fraction=1.0,
            rmse=0.0,
            num_matches=0,
            num_inliers=0,
            loss=float("nan"),
        )
        count = run.state.mapping.num_gaussians
        yield slam.Progress("frames", run.num_frames, count, None, info, run, frame)
