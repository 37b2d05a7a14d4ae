"""SPZ files: read back within the quantisation, axes turned, damage refused."""

import contextlib
import gzip
import struct
import sys
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import expit

from sfgs_jax.arrays import InputError
from sfgs_jax.splatting import Gaussians, load_spz, rgb_to_sh, save_spz
from tests.splatting.scenes import make_scene
from tests.splatting.shapes import covariances, harmonics


def valid(scene: Gaussians, name: str) -> np.ndarray:
    return np.asarray(getattr(scene, name))[np.asarray(scene.valid)]


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_what_is_read_is_what_was_written_within_the_quantisation(tmp_path, version, degree):
    scene = make_scene(degree, degree=degree)
    save_spz(tmp_path / "map.spz", scene, version=version)
    read = load_spz(tmp_path / "map.spz")
    assert np.all(read.valid)
    np.testing.assert_allclose(read.means, valid(scene, "means"), atol=0.51 / 4096)
    np.testing.assert_allclose(read.log_scales, valid(scene, "log_scales"), atol=0.51 / 16)
    opacities = expit(valid(scene, "opacity_logits"))
    np.testing.assert_allclose(expit(np.asarray(read.opacity_logits)), opacities, atol=0.51 / 255)
    sh = valid(scene, "sh")
    np.testing.assert_allclose(read.sh[:, 0], sh[:, 0], atol=0.51 / (0.15 * 255))
    np.testing.assert_allclose(read.sh[:, 1:], np.clip(sh[:, 1:], -1, 1), atol=1.01 / 128)
    quaternions = valid(scene, "quaternions")
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    cosines = np.abs(np.sum(quaternions * np.asarray(read.quaternions), axis=1))
    np.testing.assert_allclose(cosines, 1, atol=5e-6)


def test_bytes_of_one_gaussian_are_those_of_the_format(tmp_path):
    """A Gaussian whose stream is written out by hand from the description of the format."""
    gaussian = Gaussians(
        means=jnp.asarray(np.asarray([[1.0, 2.0, -3.0]], np.float32)),
        # A quarter turn about z; half a turn of the axes makes it a quarter turn the other way.
        quaternions=jnp.asarray(np.asarray([[np.sqrt(0.5) + 1e-3, 0, 0, np.sqrt(0.5)]], np.float32)),
        log_scales=jnp.asarray(np.asarray([[-4.0, -3.0, -2.0]], np.float32)),
        opacity_logits=jnp.asarray(np.zeros(1, np.float32)),
        sh=jnp.asarray(np.asarray([[[0, 1, -1], [0.5, 0, 0], [0.25, 0, 0], [-0.5, 0, 0]]], np.float32)),
        valid=jnp.asarray(np.asarray([True])),
    )
    save_spz(tmp_path / "one.spz", gaussian)
    content = gzip.decompress((tmp_path / "one.spz").read_bytes())
    assert content[:16] == struct.pack("<4sIIBBBB", b"NGSP", 3, 1, 1, 12, 0, 0)
    fixed = b"".join((value * 4096).to_bytes(3, "little", signed=True) for value in (1, -2, 3))
    assert content[16:25] == fixed
    assert content[25] == 128
    assert list(content[26:29]) == [128, 166, 89]  # 127.5 + 38.25 c
    assert list(content[29:32]) == [96, 112, 128]  # 16 (s + 10)
    (word,) = struct.unpack("<I", content[32:36])
    assert word >> 30 == 3  # w is the largest of xyzw
    assert [word >> 20 & 1023, word >> 10 & 1023] == [0, 0]
    assert word >> 9 & 1 == 1  # z turned negative
    assert word & 511 in (510, 511)
    assert list(content[36:45]) == [64, 128, 128, 96, 128, 128, 64, 128, 128]  # y, z, x: -, -, +


def test_directional_colours_turn_with_the_axes(tmp_path, rng):
    scene = make_scene(3, degree=3)
    scene = replace(scene, sh=jnp.asarray(np.clip(np.asarray(scene.sh), -0.9, 0.9)))
    save_spz(tmp_path / "map.spz", scene)
    content = np.frombuffer(gzip.decompress((tmp_path / "map.spz").read_bytes()), np.uint8)
    sh = valid(scene, "sh")
    stored = content[16 + 20 * len(sh) :].reshape(-1, 15, 3) / 128 - 1
    directions = rng.normal(size=(7, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    there = harmonics(directions * [1, -1, -1])[:, 1:] @ stored
    here = harmonics(directions)[:, 1:] @ sh[:, 1:]
    assert np.std(here) > 0.3
    np.testing.assert_allclose(there, here, atol=0.05)


def test_version_4_has_a_plain_header_and_a_table(tmp_path):
    for degree, num_streams in ((0, 5), (1, 6)):
        scene = make_scene(0, degree=degree)
        save_spz(tmp_path / "map.spz", scene, version=4)
        content = (tmp_path / "map.spz").read_bytes()
        count = int(np.sum(scene.valid))
        header = struct.pack("<4sIIBBBBI", b"NGSP", 4, count, degree, 12, 0, num_streams, 32)
        assert content[:32] == header.ljust(32, b"\0")
        rows = struct.unpack_from(f"<{2 * num_streams}Q", content, 32)
        assert (
            list(rows[1::2]) == [9 * count, count, 3 * count, 3 * count, 4 * count, 9 * count][:num_streams]
        )
        assert 32 + 16 * num_streams + sum(rows[::2]) == len(content)


def test_a_map_that_reaches_far_has_coarser_positions(tmp_path):
    scene = make_scene(0)
    far = replace(scene, means=jnp.asarray(1e5 * np.asarray(scene.means)))
    save_spz(tmp_path / "far.spz", far)
    read = load_spz(tmp_path / "far.spz")
    np.testing.assert_allclose(read.means, valid(far, "means"), atol=0.51 / 16)
    with pytest.raises(InputError, match="less than 4000 km"):
        save_spz(tmp_path / "farther.spz", replace(scene, means=jnp.asarray(1e9 * np.asarray(scene.means))))


def test_bright_colours_and_flat_gaussians_are_clipped(tmp_path):
    scene = make_scene(0, degree=0)
    white = rgb_to_sh(np.full((len(scene.means), 1, 3), 9, np.float32))
    flat = np.full((len(scene.means), 3), -30, np.float32)
    save_spz(tmp_path / "map.spz", replace(scene, sh=jnp.asarray(white), log_scales=jnp.asarray(flat)))
    read = load_spz(tmp_path / "map.spz")
    np.testing.assert_allclose(read.sh, 0.5 / 0.15, rtol=1e-5)
    np.testing.assert_allclose(read.log_scales, -10)
    assert np.all(np.isfinite(covariances(read)))


def test_damaged_files_are_refused(tmp_path):
    path = tmp_path / "map.spz"
    with pytest.raises(InputError, match="Cannot read"):
        load_spz(path)
    for version in (3, 4):
        save_spz(path, make_scene(0), version=version)
        whole = path.read_bytes()
        for length in (0, 1, 5, 20, 40, len(whole) // 2, len(whole) - 1):
            path.write_bytes(whole[:length])
            with pytest.raises(InputError, match="Cannot read"):
                load_spz(path)
        for place in range(0, len(whole), 7):
            spoiled = bytearray(whole)
            spoiled[place] ^= 0xFF
            path.write_bytes(spoiled)
            # A checksum finds the damage in gzip; a zstd frame may hide it.
            with contextlib.suppress(InputError):
                load_spz(path)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        (struct.pack("<4sIIBBBB", b"NGSP", 2, 1, 0, 12, 0, 0), "version 2; versions 3 and 4 are read"),
        (struct.pack("<4sIIBBBB", b"PLY ", 3, 1, 0, 12, 0, 0), "does not begin as one"),
        (struct.pack("<4sIIBBBB", b"NGSP", 3, 4_000_000_000, 0, 12, 0, 0), "are too much"),
        (struct.pack("<4sIIBBBB", b"NGSP", 3, 1, 4, 12, 0, 0), "degree 4"),
        (struct.pack("<4sIIBBBB", b"NGSP", 3, 1, 0, 12, 2, 0), "extensions"),
        (struct.pack("<4sIIBBBB", b"NGSP", 3, 9_000_000, 0, 12, 0, 0), "9000000 Gaussians"),
    ],
)
def test_a_header_that_promises_what_cannot_be_is_refused(tmp_path, header, message):
    (tmp_path / "map.spz").write_bytes(gzip.compress(header + bytes(20)))
    with pytest.raises(InputError, match=message):
        load_spz(tmp_path / "map.spz")


def test_without_zstd_version_4_says_what_to_install(tmp_path, monkeypatch):
    save_spz(tmp_path / "map.spz", make_scene(0), version=4)
    for name in ("backports", "compression"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(InputError, match="sfgs-jax\\[spz4\\]"):
        load_spz(tmp_path / "map.spz")
    save_spz(tmp_path / "map.spz", make_scene(0))
    load_spz(tmp_path / "map.spz")
