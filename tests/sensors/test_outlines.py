"""Outlines in depth and edges in colour."""

import numpy as np
import pytest

from sfgs_jax.sensors import colour_edges, depth_outlines, outline_agreement

HEIGHT, WIDTH = 240, 320


def picture(left, top):
    """A bright box in front of a dark wall: brightness and depth."""
    grey, depth = np.full((HEIGHT, WIDTH), 40, np.uint8), np.full((HEIGHT, WIDTH), 3.0, np.float32)
    box = np.s_[top : top + 60, left : left + 80]
    grey[box], depth[box] = 200, 1.5
    return grey, depth


@pytest.mark.parametrize("dtype", [np.int16, np.int32])
@pytest.mark.parametrize("top", [20, 150])
def test_outlines_lie_on_the_edges_of_their_own_picture_wherever_it_is(dtype, top):
    grey, depth = picture(120, top)
    outlines = depth_outlines(depth).astype(dtype)
    elsewhere = colour_edges(picture(150, 240 - 60 - top)[0])
    own, other = outline_agreement(np.stack([colour_edges(grey), elsewhere]), outlines[None])[0]
    assert own > 3
    assert other < 0.3


def test_outlines_lie_on_the_near_side():
    outlines = depth_outlines(picture(120, 150)[1])
    columns, rows = outlines.T
    assert columns.min() >= 120
    assert columns.max() < 200
    assert rows.min() >= 150
    assert rows.max() < 210


def test_outlines_beyond_the_image_do_not_count():
    edges = np.stack([colour_edges(picture(120, 150)[0])])
    outlines = depth_outlines(picture(120, 150)[1])
    beyond = np.concatenate([outlines, [[-1, 5], [WIDTH, 5], [5, HEIGHT]]])
    np.testing.assert_array_equal(
        outline_agreement(edges, beyond[None]), outline_agreement(edges, outlines[None])
    )
    assert np.isnan(outline_agreement(edges, np.full((1, 4, 2), -1))).all()
