"""PLY files in the layout of 3D Gaussian Splatting."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from plyfile import PlyData, PlyElement

from sfgs_jax.arrays import InputError
from sfgs_jax.splatting import Gaussians, load_ply, render, save_ply
from tests.splatting.scenes import CONFIG, make_camera, make_pose, make_scene


@pytest.mark.parametrize("degree", [0, 3])
def test_round_trip_keeps_the_valid_gaussians_and_how_they_look(tmp_path, degree):
    scene = make_scene(0, degree=degree)
    save_ply(tmp_path / "map.ply", scene)
    loaded = load_ply(tmp_path / "map.ply")
    valid = np.asarray(scene.valid)
    assert loaded.valid.shape == (valid.sum(),)
    assert np.all(loaded.valid)
    for name in ("means", "log_scales", "opacity_logits", "sh"):
        np.testing.assert_array_equal(getattr(loaded, name), np.asarray(getattr(scene, name))[valid])

    original, restored = (render(g, make_camera(), make_pose(), config=CONFIG) for g in (scene, loaded))
    assert np.mean(original.alpha) > 0.4
    np.testing.assert_allclose(restored.rgb, original.rgb, atol=2e-5)
    np.testing.assert_allclose(restored.depth, original.depth, atol=2e-4)


def test_layout_is_the_one_other_tools_read(tmp_path):
    sh = jnp.arange(12, dtype=jnp.float32).reshape(1, 4, 3)
    gaussian = Gaussians(
        means=jnp.asarray([[1.0, 2.0, 3.0]]),
        quaternions=jnp.asarray([[2.0, 0.0, 0.0, 0.0]]),
        log_scales=jnp.asarray([[-1.0, -2.0, -3.0]]),
        opacity_logits=jnp.asarray([0.5]),
        sh=sh,
        valid=jnp.asarray([True]),
    )
    save_ply(tmp_path / "one.ply", gaussian)
    ply = PlyData.read(str(tmp_path / "one.ply"))
    assert ply.byte_order == "<"
    assert not ply.text
    row = ply["vertex"].data[0]
    expected = {"x": 1, "z": 3, "nx": 0, "f_dc_2": 2, "opacity": 0.5, "scale_1": -2, "rot_0": 1, "rot_3": 0}
    assert {name: float(row[name]) for name in expected} == expected
    # Channel by channel: all of red, then all of green, then all of blue.
    assert [float(row[f"f_rest_{i}"]) for i in range(9)] == [3, 6, 9, 4, 7, 10, 5, 8, 11]
    assert list(row.dtype.names)[:6] == ["x", "y", "z", "nx", "ny", "nz"]


def test_an_empty_map_can_be_written_and_read(tmp_path):
    scene = make_scene(0)
    save_ply(tmp_path / "none.ply", Gaussians(**{**vars(scene), "valid": jnp.zeros_like(scene.valid)}))
    assert load_ply(tmp_path / "none.ply").means.shape == (0, 3)


def test_files_that_cannot_be_used_are_refused(tmp_path):
    path = tmp_path / "map.ply"
    with pytest.raises(InputError, match="Cannot read"):
        load_ply(path)

    path.write_text("no splats here")
    with pytest.raises(InputError, match="Cannot read"):
        load_ply(path)

    save_ply(path, make_scene(0))
    whole = path.read_bytes()
    for length in (40, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match="Cannot read"):
            load_ply(path)

    path.write_bytes(whole.replace(b"element vertex ", b"element vertex 9999999999", 1))
    with pytest.raises(InputError, match="rows and has"):
        load_ply(path)

    points = np.zeros(3, [("x", "f4"), ("y", "f4"), ("z", "f4")])
    PlyData([PlyElement.describe(points, "vertex")]).write(str(path))
    with pytest.raises(InputError, match="not a Gaussian splatting file"):
        load_ply(path)

    spoiled = make_scene(0)
    save_ply(path, Gaussians(**{**vars(spoiled), "means": spoiled.means.at[:].set(jnp.nan)}))
    with pytest.raises(InputError, match="not finite"):
        load_ply(path)


def test_a_zero_quaternion_is_written_as_no_rotation(tmp_path):
    scene = make_scene(0)
    save_ply(tmp_path / "map.ply", replace(scene, quaternions=jnp.zeros_like(scene.quaternions)))
    quaternions = np.asarray(load_ply(tmp_path / "map.ply").quaternions)
    np.testing.assert_array_equal(quaternions, np.tile([1.0, 0, 0, 0], (len(quaternions), 1)))
