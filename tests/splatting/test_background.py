"""The colour behind a map, by direction: its fit, where it shows, its file."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.geometry import Camera, se3
from sfgs_jax.splatting import (
    Gaussians,
    fitted_background,
    format_background,
    read_background,
    render,
    with_background,
)

CAMERA = Camera(24.0, 24.0, 23.5, 15.5, width=48, height=32)
POSES = se3.exps_of(np.random.default_rng(3).normal(0, [0, 0, 0, 2, 2, 2], (12, 6)))


@pytest.fixture(scope="module")
def nothing():
    """The rendering of a map without Gaussians."""
    empty = Gaussians(
        **{
            name: jnp.zeros((0, *shape))
            for name, shape in {
                "means": (3,),
                "quaternions": (4,),
                "log_scales": (3,),
                "opacity_logits": (),
                "sh": (1, 3),
            }.items()
        },
        valid=jnp.zeros(0, bool),
    )
    return render(empty, CAMERA, POSES[0])


def pictures(background, nothing, poses=POSES):
    valid = np.ones(CAMERA.shape, bool)
    for pose in poses:
        output = with_background(nothing, jnp.asarray(background, jnp.float32), CAMERA, jnp.asarray(pose))
        yield np.array(output.rgb), valid, pose


def test_a_background_is_found_again_in_what_it_shows(rng, nothing):
    background = rng.normal(0, 0.12, (9, 3))
    found = fitted_background(pictures(background, nothing), CAMERA)
    # The weight of the mean colour pulls by a few percent.
    assert np.linalg.norm(found - background) < 0.1 * np.linalg.norm(background)
    images = [list(pictures(x, nothing)) for x in (background, found)]
    errors = [np.abs(a[0] - b[0]).mean() for a, b in zip(*images, strict=True)]
    assert np.mean(errors) < 0.01


def test_directions_that_no_image_shows_have_nearly_the_mean_colour(nothing):
    valid, colour = np.ones(CAMERA.shape, bool), np.asarray([0.2, 0.5, 0.7], np.float32)
    image = np.broadcast_to(colour, (*CAMERA.shape, 3))
    found = fitted_background([(image, valid, np.eye(4))], CAMERA)
    back = se3.exps_of(np.asarray([[0, 0, 0, 0, np.pi, 0]]))
    ((seen, _, _),) = pictures(found, nothing, back)
    np.testing.assert_allclose(seen, image, atol=0.12)


def test_pixels_that_hold_no_image_have_no_say(nothing):
    image, valid = np.full((*CAMERA.shape, 3), 0.25, np.float32), np.ones(CAMERA.shape, bool)
    valid[:, 24:] = False
    image[:, 24:] = 1.0
    found = fitted_background([(image, valid, np.eye(4))], CAMERA)
    ((seen, _, _),) = pictures(found, nothing, np.eye(4)[None])
    np.testing.assert_allclose(seen[:, :24], 0.25, atol=0.02)
    with pytest.raises(InputError, match="No pixel of the images holds a colour"):
        fitted_background([(image, np.zeros_like(valid), np.eye(4))], CAMERA)


def test_it_shows_where_the_map_is_less_than_half_opaque(nothing):
    alpha = jnp.linspace(0, 1, CAMERA.width)[None] * jnp.ones((CAMERA.height, 1))
    output = replace(nothing, alpha=alpha, rgb=jnp.full((*CAMERA.shape, 3), 0.1))
    white = jnp.zeros((9, 3)).at[0].set(10.0)
    seen = np.asarray(with_background(output, white, CAMERA, jnp.eye(4)).rgb)
    share = np.clip(1 - 2 * np.asarray(alpha), 0, 1)
    np.testing.assert_allclose(seen, np.repeat((0.1 + share)[..., None], 3, axis=-1), atol=1e-6)
    gradient = jax.grad(lambda b: with_background(output, b, CAMERA, jnp.eye(4)).rgb.sum())(jnp.zeros((9, 3)))
    assert np.all(np.isfinite(gradient))
    assert float(gradient[0, 0]) == pytest.approx(share.sum() * 0.28209479, rel=1e-4)


def test_a_file_of_a_background_comes_back(tmp_path, rng):
    background = rng.normal(size=(9, 3))
    path = tmp_path / "background.txt"
    path.write_text(format_background(background))
    np.testing.assert_allclose(read_background(path), background, atol=1e-6)


@pytest.mark.parametrize(
    "text", ["", "1 2 3\n" * 8, "1 2\n" * 9, "1 2 red\n" * 9, "1 2 nan\n" * 9, "1 2 1e9\n" * 9]
)
def test_a_file_that_holds_no_background_is_refused(tmp_path, text):
    path = tmp_path / "background.txt"
    path.write_text(text)
    with pytest.raises(InputError, match=r"background.txt"):
        read_background(path)
