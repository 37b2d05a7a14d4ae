"""Lens distortion: taken out of colour and depth alike, and refused where it can't be."""

import json

import cv2
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import Camera
from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import ReaderOptions, open_recording
from sfgs_jax.sensors import Undistortion

LENS = (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)


def test_a_point_seen_through_the_lens_ends_where_a_pinhole_sees_it():
    camera = Camera(517.3, 516.5, 318.6, 255.3, width=640, height=480)
    for point in ([0.45, 0.3, 1.0], [-0.5, 0.2, 1.0], [0.1, -0.4, 1.0]):
        seen = cv2.projectPoints(
            np.asarray([point]),
            np.zeros(3),
            np.zeros(3),
            np.asarray(camera.matrix(), float),
            np.asarray(LENS),
        )[0].reshape(2)
        expected = np.asarray(camera.project(jnp.asarray(point)))
        assert np.linalg.norm(seen - expected) > 1, "the lens must move this point"
        v, u = np.mgrid[:480, :640]
        blob = np.exp(-((u - seen[0]) ** 2 + (v - seen[1]) ** 2) / 4.5).astype(np.float32)
        rgb, depth = Undistortion(camera, LENS)(np.repeat(blob[..., None], 3, -1), blob)
        for image in (rgb[..., 0], depth):
            centre = [np.sum(image * u) / image.sum(), np.sum(image * v) / image.sum()]
            np.testing.assert_allclose(centre, expected, atol=0.5)


def test_depth_is_never_mixed_across_an_edge():
    camera = Camera(517.3, 516.5, 318.6, 255.3, width=640, height=480)
    depth = np.where(np.arange(640) < 300, 1.0, 3.0).astype(np.float32) * np.ones((480, 1), np.float32)
    _, pinhole = Undistortion(camera, LENS)(np.zeros((480, 640, 3), np.float32), depth)
    assert set(np.unique(pinhole)) <= {0.0, 1.0, 3.0}


def write(folder, write_image, images, **entries):
    for kind, image in zip(("rgb", "depth"), images, strict=True):
        (folder / kind).mkdir(parents=True)
        write_image(folder / kind / "0.png", image)
    camera = {"fx": 517.3, "fy": 516.5, "cx": 318.6, "cy": 255.3} | entries
    (folder / "camera.json").write_text(json.dumps(camera))
    return folder


def test_a_camera_file_may_hold_the_lens(tmp_path, write_image, images):
    images = images(640, 480)
    plain = open_recording(write(tmp_path / "a", write_image, images))[0]
    pinhole = open_recording(write(tmp_path / "b", write_image, images, distortion=list(LENS)))[0]
    camera = Camera(517.3, 516.5, 318.6, 255.3, width=640, height=480)
    rgb, depth = Undistortion(camera, LENS)(np.asarray(plain.rgb), np.asarray(plain.depth))
    np.testing.assert_array_equal(pinhole.rgb, rgb)
    np.testing.assert_array_equal(pinhole.depth, depth)
    none = open_recording(write(tmp_path / "c", write_image, images, distortion=[0, 0, 0, 0]))[0]
    np.testing.assert_array_equal(none.rgb, plain.rgb)


@pytest.mark.parametrize("wrong", [[0.1, 0.2], "k1", [0.1, None, 0, 0], 0.3])
def test_other_distortions_are_refused(tmp_path, write_image, images, wrong):
    folder = write(tmp_path / "a", write_image, images(640, 480), distortion=wrong)
    with pytest.raises(InputError, match="list of 4, 5 or 8 numbers"):
        open_recording(folder)


def test_layouts_that_register_depth_say_that_they_take_none(tmp_path, write_image, images):
    rgb, depth = images(640, 480)
    write_image(tmp_path / "frame-000000.color.png", rgb)
    write_image(tmp_path / "frame-000000.depth.png", depth)
    camera = tmp_path / "camera.json"
    camera.write_text(json.dumps({"fx": 525, "fy": 525, "cx": 320, "cy": 240, "distortion": [0.1, 0, 0, 0]}))
    with pytest.raises(InputError, match="undistort the images first"):
        open_recording(tmp_path, options=ReaderOptions(camera=camera))
