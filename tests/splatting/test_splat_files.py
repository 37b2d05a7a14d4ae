"""`.splat` files: the records, what quantisation leaves, and files that are refused."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import expit

from sfgs_jax.arrays import InputError
from sfgs_jax.splatting import Gaussians, load_splat, rgb_to_sh, save_splat, sh_to_rgb
from tests.splatting.scenes import make_scene
from tests.splatting.shapes import covariances


def test_splat_files_hold_32_bytes_a_gaussian_the_most_visible_first(tmp_path):
    half = float(np.sqrt(0.5))
    gaussians = Gaussians(
        means=jnp.asarray([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]]),
        quaternions=jnp.asarray([[2.0, 0, 0, 0], [half, 0, -half, 0], [1.0, 0, 0, 0]]),
        log_scales=jnp.log(jnp.asarray([[0.1, 0.2, 0.3], [1.0, 2.0, 3.0], [9.0, 9.0, 9.0]])),
        opacity_logits=jnp.asarray([0.0, 20.0, 0.0]),
        sh=rgb_to_sh(jnp.asarray([[0.2, 0.4, 2.0], [1.0, 0.0, -1.0], [0.0, 0.0, 0.0]]))[:, None],
        valid=jnp.asarray([True, True, False]),
    )
    save_splat(tmp_path / "map.splat", gaussians)
    content = (tmp_path / "map.splat").read_bytes()
    assert len(content) == 2 * 32
    floats = np.frombuffer(content, "<f4").reshape(2, 8)
    np.testing.assert_allclose(floats[:, :6], [[4, 5, 6, 1, 2, 3], [1, 2, 3, 0.1, 0.2, 0.3]], rtol=1e-6)
    numbers = np.frombuffer(content, np.uint8).reshape(2, 32)[:, 24:]
    assert numbers.tolist() == [[255, 0, 0, 255, 219, 128, 37, 128], [51, 102, 255, 128, 255, 128, 128, 128]]


def test_what_is_read_is_what_was_written_within_the_quantisation(tmp_path):
    scene = make_scene(0, degree=1)
    save_splat(tmp_path / "map.splat", scene)
    read = load_splat(tmp_path / "map.splat")
    valid = np.asarray(scene.valid)
    assert read.sh.shape == (valid.sum(), 1, 3)
    # The order differs; positions are exact, so they tell which is which.
    order = np.argsort(np.asarray(scene.means)[valid][:, 0])
    here = np.argsort(np.asarray(read.means)[:, 0])
    written = {name: np.asarray(getattr(scene, name))[valid][order] for name in ("means", "log_scales")}
    for name, values in written.items():
        np.testing.assert_allclose(np.asarray(getattr(read, name))[here], values, atol=1e-6)
    logits = np.asarray(scene.opacity_logits)[valid][order]
    np.testing.assert_allclose(expit(np.asarray(read.opacity_logits)[here]), expit(logits), atol=0.51 / 255)
    colours = np.clip(sh_to_rgb(np.asarray(scene.sh)[valid][order][:, 0]), 0, 1)
    np.testing.assert_allclose(sh_to_rgb(np.asarray(read.sh)[here][:, 0]), colours, atol=0.51 / 255)
    expected = covariances(scene)[valid][order]
    size = np.linalg.norm(expected, axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(covariances(read)[here] / size, expected / size, atol=0.03)


def test_reading_and_writing_again_changes_nothing_but_rotations(tmp_path):
    save_splat(tmp_path / "map.splat", make_scene(0))
    save_splat(tmp_path / "again.splat", load_splat(tmp_path / "map.splat"))
    first, again = (
        np.frombuffer((tmp_path / name).read_bytes(), np.uint8).reshape(-1, 32)
        for name in ("map.splat", "again.splat")
    )
    first, again = (table[np.lexsort(table[:, :12].T)] for table in (first, again))
    np.testing.assert_array_equal(again[:, 24:28], first[:, 24:28])


def test_damaged_splat_files_are_refused(tmp_path):
    path = tmp_path / "map.splat"
    with pytest.raises(InputError, match="Cannot read"):
        load_splat(path)
    save_splat(path, make_scene(0))
    whole = path.read_bytes()
    for content in (b"", whole[:-1]):
        path.write_bytes(content)
        with pytest.raises(InputError, match="cut off"):
            load_splat(path)
    for place, name in ((0, "means"), (12, "log_scales")):
        path.write_bytes(whole[:place] + np.float32(-np.inf).tobytes() + whole[place + 4 :])
        with pytest.raises(InputError, match=f"{name} hold values that are not finite"):
            load_splat(path)
