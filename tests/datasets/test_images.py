"""Decoding of image files, whole and damaged."""

import cv2
import numpy as np
import pytest

from sfgs_jax.arrays import FrameError
from sfgs_jax.datasets.files import decode_colour, decode_depth, depth_units


def test_colour_is_rgb_in_unit_range(tmp_path, write_image, images):
    rgb, _ = images(7, 5)
    write_image(tmp_path / "a.png", rgb)
    got = decode_colour(tmp_path / "a.png")
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, rgb / 255, atol=1e-6)


def test_grey_image_becomes_rgb(tmp_path):
    grey = np.arange(20, dtype=np.uint8).reshape(4, 5)
    cv2.imwrite(str(tmp_path / "a.png"), grey)
    np.testing.assert_allclose(
        decode_colour(tmp_path / "a.png"), np.repeat(grey[..., None] / 255, 3, 2), atol=1e-6
    )


def test_integer_depth_has_zero_where_missing_or_saturated(tmp_path, write_image):
    units = np.array([[0, 1, 5000], [65535, 65534, 2500]], np.uint16)
    write_image(tmp_path / "d.png", units)
    got = decode_depth(tmp_path / "d.png", 5000.0)
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, [[0, 0.0002, 1], [0, 13.1068, 0.5]], rtol=1e-6)
    np.testing.assert_allclose(decode_depth(tmp_path / "d.png", None)[0, 2], 5.0, rtol=1e-6)


def test_depth_survives_the_way_to_units_and_back(tmp_path, write_image):
    depth = np.array([[0, 0.0004, 1.0], [13.1, 13.2, 100.0]], np.float32)
    units = depth_units(depth, 5000.0)
    np.testing.assert_array_equal(units, [[0, 2, 5000], [65500, 0, 0]])
    write_image(tmp_path / "d.png", units)
    np.testing.assert_allclose(decode_depth(tmp_path / "d.png", 5000.0), units / 5000, rtol=1e-6)


@pytest.mark.parametrize("suffix", [".npy", ".tiff"])
def test_floating_point_depth_is_metres_and_finite(tmp_path, suffix):
    depth = np.array([[np.nan, 1.5], [-1.0, np.inf]], np.float32)
    path = tmp_path / f"d{suffix}"
    np.save(path, depth) if suffix == ".npy" else cv2.imwrite(str(path), depth)
    np.testing.assert_allclose(decode_depth(path, None), [[0, 1.5], [0, 0]])
    np.testing.assert_allclose(decode_depth(path, 10.0)[0, 1], 0.15, rtol=1e-6)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
@pytest.mark.parametrize("kept", [0.9, 0.4, 0.0])
def test_truncated_image_is_refused(tmp_path, write_image, images, suffix, kept):
    path = tmp_path / f"a{suffix}"
    write_image(path, images(64, 48)[0])
    data = path.read_bytes()
    path.write_bytes(data[: int(kept * len(data))])
    with pytest.raises(FrameError, match="truncated"):
        decode_colour(path)


def test_damage_inside_a_png_is_refused(tmp_path, write_image, images):
    path = tmp_path / "a.png"
    write_image(path, images(64, 48)[1])
    data = bytearray(path.read_bytes())
    data[60:80] = bytes(20)
    path.write_bytes(data)
    with pytest.raises(FrameError, match=r"damaged|decoded"):
        decode_depth(path, None)


def test_file_that_is_no_image_and_missing_file_are_refused(tmp_path):
    (tmp_path / "a.png").write_text("not an image")
    with pytest.raises(FrameError, match="not an image"):
        decode_colour(tmp_path / "a.png")
    with pytest.raises(FrameError, match="cannot be read: No such file"):
        decode_colour(tmp_path / "b.png")
    (tmp_path / "a.npy").write_text("not an array")
    with pytest.raises(FrameError, match="as an array"):
        decode_depth(tmp_path / "a.npy", None)


def test_depth_of_the_wrong_kind_is_refused(tmp_path, write_image):
    write_image(tmp_path / "eight.png", np.ones((4, 4), np.uint8))
    with pytest.raises(FrameError, match="8 bits"):
        decode_depth(tmp_path / "eight.png", None)
    write_image(tmp_path / "colour.png", np.ones((4, 4, 3), np.uint8))
    with pytest.raises(FrameError, match="one channel"):
        decode_depth(tmp_path / "colour.png", None)
    np.save(tmp_path / "bool.npy", np.ones((4, 4), bool))
    with pytest.raises(FrameError, match="bool"):
        decode_depth(tmp_path / "bool.npy", None)
