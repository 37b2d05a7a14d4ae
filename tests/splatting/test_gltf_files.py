"""Binary glTF with splats: its structure, the Gaussians in its axes, and the point cloud of its fallback."""

import json
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from scipy.special import expit

from sfgs_jax.arrays import InputError
from sfgs_jax.splatting import GAUSSIAN_PARAMETERS, contents_of, load_gltf, save_gltf, sh_to_rgb
from tests.splatting.scenes import make_scene
from tests.splatting.shapes import covariances, harmonics

TURN = np.diag([1.0, -1.0, -1.0])
SPLATS = "KHR_gaussian_splatting"


def chunks_of(path: Path) -> tuple[dict[str, Any], bytes]:
    """Description and data of a .glb file, its container checked on the way."""
    content = path.read_bytes()
    assert struct.unpack_from("<4sII", content) == (b"glTF", 2, len(content))
    length, kind = struct.unpack_from("<I4s", content, 12)
    assert (kind, length % 4) == (b"JSON", 0)
    data_length, data_kind = struct.unpack_from("<I4s", content, 20 + length)
    assert (data_kind, data_length % 4) == (b"BIN\0", 0)
    data = content[28 + length :]
    assert len(data) == data_length
    return json.loads(content[20 : 20 + length]), data


def attributes_of(path: Path) -> dict[str, np.ndarray]:
    """Attributes of the only primitive, by name."""
    description, data = chunks_of(path)
    found = {}
    for name, index in description["meshes"][0]["primitives"][0]["attributes"].items():
        accessor = description["accessors"][index]
        view = description["bufferViews"][accessor["bufferView"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        assert accessor["componentType"] == 5126
        assert view["byteOffset"] % 4 == 0
        assert view["byteLength"] == accessor["count"] * width * 4
        values = np.frombuffer(data, "<f4", accessor["count"] * width, view["byteOffset"])
        found[name] = values.reshape(-1, width)
    return found


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_the_gaussians_are_there_after_half_a_turn_about_x(tmp_path, rng, degree):
    scene = make_scene(degree, degree=degree)
    valid = np.asarray(scene.valid)
    save_gltf(tmp_path / "map.glb", scene)
    found = attributes_of(tmp_path / "map.glb")
    np.testing.assert_allclose(found["POSITION"], np.asarray(scene.means)[valid] @ TURN)
    np.testing.assert_allclose(
        found[f"{SPLATS}:OPACITY"][:, 0], expit(np.asarray(scene.opacity_logits)[valid]), rtol=1e-6
    )

    axes = Rotation.from_quat(found[f"{SPLATS}:ROTATION"]).as_matrix()
    spread = axes * found[f"{SPLATS}:SCALE"][:, None, :]
    expected = TURN @ covariances(scene)[valid] @ TURN
    np.testing.assert_allclose(spread @ spread.transpose(0, 2, 1), expected, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(found[f"{SPLATS}:ROTATION"], axis=1), 1, rtol=1e-6)

    names = [f"{SPLATS}:SH_DEGREE_{d}_COEF_{n}" for d in range(degree + 1) for n in range(2 * d + 1)]
    assert sum("SH_DEGREE" in name for name in found) == len(names) == (degree + 1) ** 2
    stored = np.stack([found[name] for name in names], axis=1)
    directions = rng.normal(size=(7, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    here = harmonics(directions)[:, : len(names)] @ np.asarray(scene.sh)[valid]
    there = harmonics(directions @ TURN)[:, : len(names)] @ stored
    np.testing.assert_allclose(there, here, atol=1e-6)


def test_the_extension_is_used_but_not_required(tmp_path):
    save_gltf(tmp_path / "map.glb", make_scene(0))
    description, _ = chunks_of(tmp_path / "map.glb")
    assert description["asset"]["version"] == "2.0"
    assert description["extensionsUsed"] == [SPLATS]
    assert "extensionsRequired" not in description
    (primitive,) = description["meshes"][0]["primitives"]
    assert primitive["mode"] == 0
    assert primitive["extensions"] == {SPLATS: {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}}
    bounds = description["accessors"][primitive["attributes"]["POSITION"]]
    positions = attributes_of(tmp_path / "map.glb")["POSITION"]
    np.testing.assert_allclose([bounds["min"], bounds["max"]], [positions.min(0), positions.max(0)])


def test_programs_without_the_extension_see_a_coloured_point_cloud(tmp_path):
    scene = make_scene(0)
    valid = np.asarray(scene.valid)
    save_gltf(tmp_path / "map.glb", scene)
    loaded = trimesh.load(tmp_path / "map.glb")
    assert isinstance(loaded, trimesh.Scene)
    (cloud,) = loaded.geometry.values()
    assert isinstance(cloud, trimesh.PointCloud)
    np.testing.assert_allclose(cloud.vertices, np.asarray(scene.means)[valid] @ TURN)

    colours = attributes_of(tmp_path / "map.glb")["COLOR_0"]
    rgb = np.clip(sh_to_rgb(np.asarray(scene.sh)[valid][:, 0]), 0, 1)
    bright = rgb > 0.0031308 * 12.92
    srgb = 1.055 * np.maximum(colours[:, :3], 1e-9) ** (1 / 2.4) - 0.055
    assert np.mean(bright) > 0.5
    np.testing.assert_allclose(srgb[bright], rgb[bright], atol=1e-5)
    np.testing.assert_allclose(12.92 * colours[:, :3][~bright], rgb[~bright], atol=1e-5)
    np.testing.assert_allclose(colours[:, 3], expit(np.asarray(scene.opacity_logits)[valid]), atol=1e-5)
    np.testing.assert_allclose(np.asarray(cloud.colors), 255 * colours, atol=1.01)


def test_an_empty_map_is_refused(tmp_path):
    scene = make_scene(0)
    with pytest.raises(InputError, match="at least one Gaussian"):
        save_gltf(tmp_path / "map.glb", replace(scene, valid=jnp.asarray(np.zeros(len(scene.means), bool))))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("degree", [0, 3])
def test_what_was_saved_is_loaded(tmp_path, degree):
    scene = make_scene(degree, degree=degree)
    valid = np.asarray(scene.valid)
    save_gltf(tmp_path / "map.glb", scene)
    assert contents_of(tmp_path / "map.glb") == "splats"
    found = load_gltf(tmp_path / "map.glb")
    assert np.asarray(found.valid).all()
    for name in GAUSSIAN_PARAMETERS:
        wanted = np.asarray(getattr(scene, name))[valid]
        if name == "quaternions":
            wanted = wanted / np.linalg.norm(wanted, axis=1, keepdims=True)
        np.testing.assert_allclose(getattr(found, name), wanted, rtol=1e-4, atol=1e-4, err_msg=name)


def changed(path: Path, change) -> None:
    """Rewrite the description of a file."""
    description, data = chunks_of(path)
    change(description)
    text = json.dumps(description).encode()
    text += b" " * (-len(text) % 4)
    parts = [struct.pack("<I4s", len(text), b"JSON"), text, struct.pack("<I4s", len(data), b"BIN\0"), data]
    body = b"".join(parts)
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)


def test_normalised_integers_and_strides_are_read(tmp_path):
    """As other programs write them: opacities as bytes, four bytes apart."""
    path = tmp_path / "map.glb"
    save_gltf(path, make_scene(0))
    wanted = np.asarray(load_gltf(path).opacity_logits)

    def as_bytes(description):
        index = description["meshes"][0]["primitives"][0]["attributes"][f"{SPLATS}:OPACITY"]
        accessor = description["accessors"][index]
        view = description["bufferViews"][accessor["bufferView"]]
        levels = np.zeros((accessor["count"], 4), np.uint8)
        levels[:, 0] = np.round(255 * expit(wanted))
        view["byteStride"] = 4
        accessor |= {"componentType": 5121, "normalized": True}
        content = path.read_bytes()
        start = content.index(b"BIN\0") + 4 + view["byteOffset"]
        path.write_bytes(content[:start] + levels.tobytes() + content[start + levels.nbytes :])

    description, _ = chunks_of(path)
    as_bytes(description)
    changed(path, lambda old: old.update(description))
    np.testing.assert_allclose(expit(load_gltf(path).opacity_logits), expit(wanted), atol=0.5 / 255 + 1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d["meshes"][0]["primitives"][0].pop("extensions"), "holds no Gaussians"),
        (lambda d: d["nodes"][0].update(scale=[2, 2, 2]), "moves its Gaussians"),
        (lambda d: d["accessors"][0].update(count=10**9), "damaged or compressed"),
        (lambda d: d["accessors"][0].update(componentType=7), "damaged or compressed"),
        (lambda d: d["accessors"][0].update(type="VEC2"), "damaged or compressed"),
        (lambda d: d["bufferViews"].clear(), "damaged or compressed"),
        (lambda d: d["meshes"][0]["primitives"][0]["attributes"].pop("POSITION"), "damaged or compressed"),
    ],
)
def test_other_files_are_refused(tmp_path, change, message):
    path = tmp_path / "map.glb"
    save_gltf(path, make_scene(0))
    changed(path, change)
    with pytest.raises(InputError, match=message):
        load_gltf(path)


@pytest.mark.parametrize("length", [0, 11, 30, -1])
def test_files_that_are_cut_off_are_refused(tmp_path, length):
    path = tmp_path / "map.glb"
    save_gltf(path, make_scene(0))
    path.write_bytes(path.read_bytes()[:length])
    with pytest.raises(InputError, match="no binary glTF"):
        load_gltf(path)


def test_a_nan_that_signals_is_refused_without_a_warning(tmp_path):
    """Warnings are errors in the tests."""
    path = tmp_path / "map.glb"
    scene = make_scene(1)
    save_gltf(path, scene)
    content = path.read_bytes()
    number = attributes_of(path)["POSITION"][0, 0].tobytes()
    path.write_bytes(content.replace(number, struct.pack("<I", 0x7F800001), 1))
    with pytest.raises(InputError, match="not finite"):
        load_gltf(path)
