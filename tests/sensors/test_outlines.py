"""Outlines in depth and edges in colour."""

import numpy as np
import pytest

from sfgs_jax.sensors import Outlines, colour_edges, depth_outlines, outline_agreement

HEIGHT, WIDTH = 240, 320


def picture(left, top):
    """A bright box in front of a dark wall: brightness and depth."""
    grey, depth = np.full((HEIGHT, WIDTH), 40, np.uint8), np.full((HEIGHT, WIDTH), 3.0, np.float32)
    box = np.s_[top : top + 60, left : left + 80]
    grey[box], depth[box] = 200, 1.5
    return grey, depth


def alone(outlines, dtype=np.int32):
    """Outlines in one place."""
    return Outlines(outlines.pixels[None].astype(dtype), outlines.across[None])


@pytest.mark.parametrize("dtype", [np.int16, np.int32])
@pytest.mark.parametrize("top", [20, 150])
def test_outlines_lie_on_the_edges_of_their_own_picture_wherever_it_is(dtype, top):
    grey, depth = picture(120, top)
    elsewhere = colour_edges(picture(150, 240 - 60 - top)[0])
    edges = np.stack([colour_edges(grey), elsewhere])
    own, other = outline_agreement(edges, alone(depth_outlines(depth), dtype))[0]
    assert own > 3
    assert abs(other) < 0.3


def test_edges_across_an_outline_speak_against_it():
    grey, depth = picture(120, 150)
    outlines = depth_outlines(depth)
    turned = Outlines(outlines.pixels, outlines.across[:, ::-1])
    along, across = (outline_agreement(colour_edges(grey)[None], alone(some)) for some in (outlines, turned))
    np.testing.assert_allclose(across, -along, rtol=0.1)


def test_stripes_agree_with_outlines_by_chance_alone():
    rng = np.random.default_rng(0)
    stripes = np.broadcast_to(rng.integers(0, 255, WIDTH).astype(np.uint8), (HEIGHT, WIDTH)).copy()
    outlines = alone(depth_outlines(picture(120, 150)[1]))
    assert abs(outline_agreement(colour_edges(stripes)[None], outlines)[0, 0]) < 0.2


def test_outlines_lie_on_the_near_side_and_point_across():
    outlines = depth_outlines(picture(120, 150)[1])
    columns, rows = outlines.pixels.T
    assert columns.min() >= 120
    assert columns.max() < 200
    assert rows.min() >= 150
    assert rows.max() < 210
    np.testing.assert_allclose(np.linalg.norm(outlines.across, axis=1), 1, rtol=1e-6)
    at_the_left = (columns < 123) & (rows > 160) & (rows < 200)
    assert at_the_left.any()
    np.testing.assert_allclose(np.abs(outlines.across[at_the_left]), [[1, 0]] * at_the_left.sum(), atol=1e-3)


def test_outlines_move_across_to_the_far_side():
    outlines = depth_outlines(picture(120, 150)[1])
    far, near = outlines.moved(-2), outlines.moved(2)
    left = (outlines.pixels[:, 0] < 123) & (outlines.pixels[:, 1] > 160) & (outlines.pixels[:, 1] < 200)
    for moved, by in ((far, -2), (near, 2)):
        off = moved.pixels[left] - outlines.pixels[left]
        np.testing.assert_array_equal(off, [[by, 0]] * left.sum())
        np.testing.assert_array_equal(moved.across, outlines.across)


@pytest.mark.parametrize("unit", [1e-30, 1e3, 1e30])
def test_the_unit_of_depth_does_not_matter_nor_do_holes_behind_an_outline(unit):
    _, depth = picture(120, 150)
    holes = depth.copy()
    holes[145:215, 200] = 0
    plain, other = depth_outlines(depth), depth_outlines(holes * np.float32(unit))
    common = np.isin(other.pixels @ [1, WIDTH], plain.pixels @ [1, WIDTH])
    assert common.mean() > 0.95
    at_the_right = (other.pixels[:, 0] > 196) & (other.pixels[:, 1] > 160) & (other.pixels[:, 1] < 200)
    assert at_the_right.sum() > 20
    assert np.abs(other.across[at_the_right, 0]).min() > 0.999


def test_outlines_beyond_the_image_do_not_count():
    edges = colour_edges(picture(120, 150)[0])[None]
    outlines = depth_outlines(picture(120, 150)[1])
    beyond = Outlines(
        np.concatenate([outlines.pixels, [[-1, 5], [WIDTH, 5], [5, HEIGHT]]]),
        np.concatenate([outlines.across, np.ones((3, 2), np.float32)]),
    )
    np.testing.assert_array_equal(
        outline_agreement(edges, alone(beyond)), outline_agreement(edges, alone(outlines))
    )
    nowhere = Outlines(np.full((1, 4, 2), -1), np.zeros((1, 4, 2), np.float32))
    assert np.isnan(outline_agreement(edges, nowhere)).all()
