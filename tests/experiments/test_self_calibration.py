"""Self-calibration in miniature: the descent finds what the camera's calibration has wrong."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.calibration_model import step
from experiments.self_calibration import clip_of, errors, scene_of, truth_of, twists, wrong
from sfgs_jax.datasets import KinectFaults, SyntheticRecording
from sfgs_jax.geometry import se3

FAULTS = KinectFaults(depth_delay=0.015, extrinsic_shift=0.01, extrinsic_turn=0.01)


@pytest.fixture(scope="module")
def recording():
    return SyntheticRecording(num_frames=48, width=112, height=84, faults=FAULTS)


@pytest.fixture(scope="module")
def posed(recording):
    """A clip, its scene with the motion of its views, and their poses."""
    clip = clip_of(recording, 0, 26, 112)
    scene = scene_of(clip, keypoints=128)
    poses = recording.ground_truth.poses[: len(clip.rgb)]
    views = replace(scene.views, twist=jnp.asarray(twists(poses, clip.elapsed)[scene.frames]))
    return clip, scene, views, jnp.asarray(se3.parameters_of(poses[scene.frames]), jnp.float32)


def test_the_start_is_as_wrong_as_it_says(recording, rng):
    truth = truth_of(recording)
    off = errors(wrong(rng, truth), truth)
    np.testing.assert_allclose(off, [5, 5, 20, 2, 20, 0, 0], rtol=1e-3, atol=1e-3)
    assert not np.any(errors(truth, truth))


fast_step = jax.jit(
    step, compiler_options={"xla_backend_optimization_level": 2, "xla_cpu_use_fusion_emitters": True}
)
"""This one runs long enough to be worth its optimisation."""


def test_the_descent_finds_focal_lengths_delay_and_extrinsic(recording, posed, rng):
    clip, scene, views, poses = posed
    truth = truth_of(recording)
    calibration = start = wrong(rng, truth)
    # The experiment mixes indices and lanes freely, which the tests' strict promotion refuses.
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        for width, bright in ((8, 0), (8, 0), (3, 0), (2, 0), (2, 1), (2, 1), (2, 1)):
            settings = jnp.float32(width), jnp.float32(bright)
            after = fast_step(clip.camera, calibration, start, poses, views, scene.pairs, *settings)
            calibration, poses = after.calibration, after.poses
    focal_x, focal_y, _, turn, delay, *_ = errors(calibration, truth)
    # From 5 % and 5 %, 2 degrees and 20 ms.
    assert max(focal_x, focal_y) < 0.6
    assert turn < 0.4
    assert delay < 1
