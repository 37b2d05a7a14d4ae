"""Colour and depth of different sizes brought to one."""

import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets.files import FilePair, Intrinsics, common_view, resized_depth


def _plane(width: int, height: int) -> np.ndarray:
    """Depth of a slanted plane, seen by a camera whose field of view does not depend on the size."""
    v, u = np.mgrid[:height, :width]
    x, y = (u + 0.5) / width - 0.5, (v + 0.5) / height - 0.5
    return (1 / (0.5 + 0.2 * x - 0.1 * y)).astype(np.float32)


def test_a_plane_stays_a_plane():
    got = resized_depth(_plane(32, 24), (80, 60))
    np.testing.assert_allclose(got[2:-2, 2:-2], _plane(80, 60)[2:-2, 2:-2], rtol=1e-5)
    assert got.dtype == np.float32


def test_no_points_between_surfaces_and_holes_stay():
    depth = _plane(32, 24)
    depth[:, 16:] += 1.0
    depth[5:8, 5:8] = 0
    got = resized_depth(depth, (64, 48))
    step = got[:, 30:34]
    assert ((step[:, :2] < 2.4) & (step[:, 2:] > 2.4)).all()
    np.testing.assert_array_equal(got == 0, (depth == 0).repeat(2, 0).repeat(2, 1))


def test_larger_depth_shrinks_to_pixels_of_its_own():
    depth = _plane(64, 48)
    assert np.isin(resized_depth(depth, (32, 24)), depth).all()


@pytest.fixture
def pair(tmp_path, write_image):
    def write(colour: tuple[int, int], depth: tuple[int, int]) -> list[FilePair]:
        write_image(tmp_path / "rgb.png", np.full((colour[1], colour[0], 3), 128, np.uint8))
        write_image(tmp_path / "depth.png", (1000 * _plane(*depth)).astype(np.uint16))
        return [FilePair(tmp_path / "rgb.png", tmp_path / "depth.png", 0.0)]

    return write


def test_large_colour_comes_down_to_640(pair, tmp_path):
    pairs = pair((1920, 1440), (256, 192))
    view = common_view(tmp_path, pairs, None, Intrinsics(1500.0, 1500.0, 959.5, 700.0))
    assert view.camera.shape == (480, 640)
    numbers = [float(x) for x in (view.camera.fx, view.camera.fy, view.camera.cx, view.camera.cy)]
    np.testing.assert_allclose(numbers, [500, 500, 319.5, 233], rtol=1e-6)
    assert view.register is not None
    rgb, depth = view.register(np.zeros((1440, 1920, 3), np.float32), _plane(256, 192))
    assert rgb.shape == (480, 640, 3)
    np.testing.assert_allclose(depth[3:-3, 3:-3], _plane(640, 480)[3:-3, 3:-3], rtol=1e-5)


@pytest.mark.parametrize(("depth", "size"), [((32, 24), (64, 48)), ((64, 48), (64, 48))])
def test_small_colour_keeps_its_size(pair, tmp_path, depth, size):
    view = common_view(tmp_path, pair((64, 48), depth), None, Intrinsics(50.0, 50.0, 31.5, 23.5))
    assert view.camera.shape == size[::-1]
    assert (view.register is None) == (depth == size)


def test_the_lens_is_taken_out_at_the_common_size(pair, tmp_path):
    intrinsics = Intrinsics(100.0, 100.0, 63.5, 47.5, distortion=(0.1, 0.0, 0.0, 0.0))
    view = common_view(tmp_path, pair((128, 96), (64, 48)), None, intrinsics)
    assert view.register is not None
    _, depth = view.register(np.zeros((96, 128, 3), np.float32), np.full((48, 64), 2, np.float32))
    assert depth.shape == (96, 128)
    assert depth[48, 64] == 2
    assert depth[0, 0] == 0  # beyond the lens's field of view


def test_another_aspect_ratio_is_refused(pair, tmp_path):
    with pytest.raises(InputError, match="64x48 but depth images are 32x32"):
        common_view(tmp_path, pair((64, 48), (32, 32)), None, Intrinsics(50.0, 50.0, 31.5, 23.5))
