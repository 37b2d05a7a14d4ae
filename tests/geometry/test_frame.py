"""Frames: what is refused, with what sentence, and what is free."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import Frame
from sfgs_jax.arrays import InputError
from sfgs_jax.geometry import clean_depth

RGB, DEPTH = np.full((4, 6, 3), 0.5, np.float32), np.full((4, 6), 2.0, np.float32)


@pytest.mark.parametrize(
    ("rgb", "depth", "words"),
    [
        (
            (255 * RGB).astype(np.uint8),
            DEPTH,
            r"not uint8 of shape \(4, 6, 3\); divide .* by 255",
        ),
        (RGB.astype(np.float16), DEPTH, "not float16"),
        (RGB[..., 0], DEPTH, r"colour .* not float32 of shape \(4, 6\)"),
        (np.zeros((4, 6, 4), np.float32), DEPTH, r"colour .* \(4, 6, 4\)"),
        (RGB, (1000 * DEPTH).astype(np.uint16), "not uint16 .* 1000 for millimetres"),
        (RGB, DEPTH.T, r"depth .* of its colour's shape \(4, 6\), not float32 of shape \(6, 4\)"),
        (RGB, DEPTH[..., None], "depth"),
    ],
)
@pytest.mark.parametrize("on", [np.asarray, jnp.asarray])
def test_images_of_another_type_or_shape_are_refused(rgb, depth, words, on):
    with pytest.raises(InputError, match=words):
        Frame(on(rgb), on(depth), 0.0)


def test_frames_are_pytrees_whose_leaves_may_become_anything():
    frame = Frame(RGB, DEPTH, 1.5)
    assert frame.timestamp == 1.5
    shapes = jax.tree.map(np.shape, frame)
    assert (shapes.rgb, shapes.depth) == ((4, 6, 3), (4, 6))
    several = jax.tree.map(lambda x: jnp.stack([x, x]), frame)
    means = jax.vmap(lambda f: jnp.mean(f.rgb) + jnp.mean(f.depth))(several)
    np.testing.assert_allclose(means, 2.5)


def test_depth_may_have_a_time_of_its_own():
    assert Frame(RGB, DEPTH, 1.5).depth_timestamp is None
    frame = Frame(RGB, DEPTH, 1.5, depth_timestamp=1.51)
    late = jax.jit(lambda f: f.depth_timestamp - f.timestamp)(frame)
    np.testing.assert_allclose(late, 0.01, rtol=1e-4)
    # An unknown time is no leaf.
    assert len(jax.tree.leaves(frame)) == len(jax.tree.leaves(Frame(RGB, DEPTH, 1.5))) + 1
    assert jax.jit(lambda f: f)(Frame(RGB, DEPTH, 1.5)).depth_timestamp is None


def test_a_frame_made_of_traced_images_costs_nothing():
    def made(rgb, depth):
        frame = Frame(rgb, depth, 0.0)
        return frame.rgb, frame.depth

    assert len(jax.make_jaxpr(made)(RGB, DEPTH).eqns) == 0
    with pytest.raises(InputError, match="uint16"):
        jax.jit(made)(RGB, DEPTH.astype(np.uint16))


def test_clean_depth_masks_what_is_missing():
    depth, valid = clean_depth(jnp.asarray([1.0, 0.0, -1.0, np.nan, np.inf]))
    np.testing.assert_array_equal(depth, [1, 0, 0, 0, 0])
    np.testing.assert_array_equal(valid, [True, False, False, False, False])
