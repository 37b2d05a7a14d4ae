"""XFeat around onnxruntime: where its keypoints lie, at any image size."""

import cv2
import jax.numpy as jnp
import numpy as np
import pytest

from experiments import xfeat
from experiments.xfeat_size import resized_xfeat
from sfgs_jax.arrays import InputError
from sfgs_jax.superfeats import match


@pytest.fixture(scope="module")
def network(sfgs_data):
    return xfeat.XFeat(sfgs_data / "weights" / "xfeat_640x640.onnx")


@pytest.fixture(scope="module")
def photo(sfgs_data) -> np.ndarray:
    path = sfgs_data / "data/7scenes/redkitchen/frame-000300.color.jpg"
    return cv2.imread(str(path))[..., ::-1].astype(np.float32) / 255


def matched(a, b, floor: float = xfeat.MIN_SIMILARITY) -> tuple[np.ndarray, np.ndarray]:
    matches = match(a, b, min_similarity=floor)
    valid = np.asarray(matches.valid)
    return np.asarray(a.keypoints)[valid], np.asarray(b.keypoints)[np.asarray(matches.index_b)[valid]]


def test_features_are_unit_vectors_in_order_of_score(network, photo):
    features = network.extract(photo, max_keypoints=2048)
    assert features.descriptors.shape == (2048, 64)
    assert features.descriptors.dtype == jnp.float32
    assert np.all(features.valid)
    np.testing.assert_allclose(np.linalg.norm(features.descriptors, axis=1), 1, atol=1e-5)
    assert np.all(np.diff(features.scores) <= 0)
    keypoints = np.asarray(features.keypoints)
    assert np.all((keypoints >= 0) & (keypoints < [640, 480]))
    # Five by five windows hold one keypoint each.
    gaps = np.abs(keypoints[:, None] - keypoints).max(axis=2) + 10 * np.eye(len(keypoints))
    assert gaps.min() >= 3


def test_keypoints_follow_a_cut_of_the_image(network, photo):
    whole, cut = (network.extract(image, max_keypoints=1024) for image in (photo, photo[40:430, 64:600]))
    a, b = matched(whole, cut)
    errors = np.linalg.norm(a - [64, 40] - b, axis=1)
    assert len(a) > 400
    assert np.median(errors) < 0.5
    assert np.mean(errors < 3) > 0.95


def test_a_larger_image_has_its_keypoints_in_its_own_pixels(network, photo):
    large = cv2.resize(photo, (1280, 960), interpolation=cv2.INTER_CUBIC)
    a, b = matched(network.extract(photo), network.extract(large))
    errors = np.linalg.norm(2 * a + 0.5 - b, axis=1)
    assert len(a) > 400
    assert np.median(errors) < 1.5


def test_an_image_without_texture_has_no_keypoints(network):
    features = network.extract(np.full((100, 200), 0.5, np.float32), max_keypoints=16)
    assert not np.any(features.valid)
    assert not np.any(features.descriptors)


def test_the_graph_of_another_size_has_the_same_weights(network, photo, sfgs_data):
    weights = sfgs_data / "weights" / "xfeat_640x640.onnx"
    same = xfeat.XFeat(resized_xfeat(weights, 640, 640))
    image = np.zeros((640, 640), np.float32)
    image[:480] = xfeat.normalised(photo.mean(axis=2))
    for expected, actual in zip(network.dense(image), same.dense(image), strict=True):
        np.testing.assert_allclose(actual, expected, atol=1e-4)
    small = xfeat.XFeat(resized_xfeat(weights, 480, 640))
    assert small.shape == (480, 640)
    a, b = matched(small.extract(photo), network.extract(photo))
    assert len(a) > 1800
    assert np.mean(np.linalg.norm(a - b, axis=1) < 1) > 0.95


def test_missing_weights_are_refused(monkeypatch, tmp_path):
    monkeypatch.setenv("SFGS_DATA", str(tmp_path))
    with pytest.raises(InputError, match="set SFGS_DATA"):
        xfeat.default_weights()
