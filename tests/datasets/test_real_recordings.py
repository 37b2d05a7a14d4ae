"""The real recordings: they open, and depth lies where colour says."""

import cv2
import numpy as np

from sfgs_jax.datasets import ReaderOptions, open_recording
from sfgs_jax.datasets.files import decode_depth


def _edge_agreement(rgb: np.ndarray, depth: np.ndarray) -> float:
    """Mean colour gradient at jumps of depth, as a multiple of the whole image's."""
    grey = cv2.GaussianBlur(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), (0, 0), 1.0)
    gradient = np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1))
    valid = cv2.erode((depth > 0).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    nearest = cv2.erode(depth, np.ones((3, 3), np.uint8))
    # The near side of a jump: there the surface in front ends, and its picture with it.
    jump = valid & (cv2.dilate(depth, np.ones((3, 3), np.uint8)) > 1.08 * depth) & (depth < nearest * 1.02)
    assert jump.sum() > 200
    return float(gradient[jump].mean() / gradient.mean())


def test_redkitchen_depth_is_registered_to_colour(sfgs_data):
    recording = open_recording(
        sfgs_data / "data/7scenes/redkitchen", options=ReaderOptions(end=200, stride=40)
    )
    assert (recording.dataset, len(recording), recording.camera.shape) == ("7scenes", 5, (480, 640))
    assert recording.ground_truth is not None
    assert len(recording.ground_truth) == 5
    registered, raw = [], []
    for i in range(len(recording)):
        frame = recording[i]
        rgb, depth = np.asarray(frame.rgb), np.asarray(frame.depth)
        assert 0.6 < (depth > 0).mean() < 0.9
        registered.append(_edge_agreement(rgb, depth))
        path = sfgs_data / f"data/7scenes/redkitchen/frame-{40 * i:06d}.depth.png"
        raw.append(_edge_agreement(rgb, decode_depth(path, 1000.0)))
    assert np.mean(registered) > 1.2 * np.mean(raw)


def test_redkitchen_depth_has_no_speckle_holes(sfgs_data):
    recording = open_recording(sfgs_data / "data/7scenes/redkitchen", options=ReaderOptions(end=1))
    valid = np.asarray(recording[0].depth) > 0
    neighbours = cv2.boxFilter(valid.astype(np.float32), -1, (3, 3), normalize=False)
    isolated = ~valid & (neighbours >= 7)
    assert isolated.mean() < 1e-3


def test_fr1_rpy(sfgs_data):
    recording = open_recording(sfgs_data / "data/tum/rgbd_dataset_freiburg1_rpy")
    assert (recording.dataset, len(recording)) == ("tum", 300)
    assert float(recording.camera.fx) == np.float32(517.3)
    truth = recording.ground_truth
    assert truth is not None
    assert len(truth) > 290
    assert np.isfinite(truth.poses).all()
    frame = recording[150]
    rgb, depth = np.asarray(frame.rgb), np.asarray(frame.depth)
    assert frame.timestamp == recording.timestamps[150]
    assert 0.5 < np.median(depth[depth > 0]) < 5
    # Depth is registered already: moved aside it fits colour worse.
    aside = [_edge_agreement(rgb, np.roll(depth, shift, axis=1)) for shift in (-12, 12)]
    assert _edge_agreement(rgb, depth) > 1.1 * max(aside)
