"""Image-pair sets, written small in the layouts in which they are distributed."""

import json

import cv2
import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import (
    HPATCHES_LARGE,
    HomographyPair,
    PosePair,
    read_hpatches,
    read_megadepth_1500,
    read_pair_list,
    read_scannet_1500,
)

K_A = np.array([[500.0, 0, 31.5], [0, 510, 23.5], [0, 0, 1]])
K_B = np.array([[400.0, 0, 30], [0, 410, 20], [0, 0, 1]])
T_B_A = np.eye(4)
T_B_A[:3, :3] = cv2.Rodrigues(np.array([0.1, 0.3, -0.2]))[0]
T_B_A[:3, 3] = [0.5, -0.1, 0.2]


def words(*arrays: np.ndarray) -> str:
    return " ".join(f"{value:.12g}" for array in arrays for value in np.ravel(array))


def assert_is_the_pair(pair: PosePair) -> None:
    np.testing.assert_allclose(pair.K_a, K_A)
    np.testing.assert_allclose(pair.K_b, K_B)
    np.testing.assert_allclose(pair.T_b_a, T_B_A, atol=1e-9)


@pytest.fixture
def two_images(write_image, images, tmp_path):
    """Writes the two images of a pair, 64x48, below the test's folder."""

    def write(*names: str) -> None:
        for name in names:
            write_image(tmp_path / name, images(64, 48)[0])

    return write


@pytest.mark.parametrize("flags", ["0 0 ", ""])
@pytest.mark.parametrize("short", [True, False])
def test_lists_with_and_without_flags_and_with_either_motion(tmp_path, two_images, flags, short):
    two_images("a/1.png", "b/2.png")
    motion = words(T_B_A[:3, :3], T_B_A[:3, 3]) if short else words(T_B_A)
    (tmp_path / "pairs.txt").write_text(f"a/1.png b/2.png {flags}{words(K_A, K_B)} {motion}\n\n")
    if flags and short:
        with pytest.raises(InputError, match=r"line 1: a pair has 38 words, or 32 or 36 .* not 34"):
            read_pair_list(tmp_path / "pairs.txt")
        return
    (pair,) = read_pair_list(tmp_path / "pairs.txt")
    assert_is_the_pair(pair)
    assert (pair.image_a, pair.image_b) == (tmp_path / "a/1.png", tmp_path / "b/2.png")
    (a, b), (K_a, _) = pair.load()
    assert a.shape == b.shape == (48, 64, 3)
    np.testing.assert_array_equal(K_a, K_A)


def test_shrunk_images_come_with_shrunk_intrinsics(tmp_path, two_images):
    two_images("1.png", "2.png")
    pair = PosePair("", tmp_path / "1.png", tmp_path / "2.png", K_A, K_B, T_B_A)
    (a, _), (K_a, K_b) = pair.load(longest=32)
    assert a.shape == (24, 32, 3)
    # The image's middle, between the pixels of both sizes, stays its middle.
    np.testing.assert_allclose(K_a, [[250, 0, 15.5], [0, 255, 11.5], [0, 0, 1]])
    np.testing.assert_allclose(K_b[:2, 2], [14.75, 9.75])


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("1.png 2.png 1 0 {numbers}", "to be rotated"),
        ("1.png 2.png {numbers} x", "36 without rotation flags, not 37"),
        ("1.png 2.png 0 zero {numbers}", "expected numbers"),
        ("1.png 9.png {numbers}", "1 of the 2 images .* are missing"),
        ("1.png 2.png {still}", "translation that is not zero"),
        ("1.png 2.png {broken}", "not finite"),
        ("", "lists no pairs"),
    ],
)
def test_broken_lists_are_refused(tmp_path, two_images, line, message):
    two_images("1.png", "2.png")
    line = line.format(
        numbers=words(K_A, K_B, T_B_A),
        still=words(K_A, K_B, np.eye(4)),
        broken=words(K_A, K_B * np.nan, T_B_A),
    )
    (tmp_path / "pairs.txt").write_text(line)
    with pytest.raises(InputError, match=message):
        read_pair_list(tmp_path / "pairs.txt")


def test_megadepth_1500_of_glue_factory(tmp_path, two_images):
    two_images("images/0015/1.png", "images/0022/2.png")
    line = f"0015/1.png 0022/2.png {words(K_A, K_B, T_B_A[:3, :3], T_B_A[:3, 3])}"
    (tmp_path / "pairs_calibrated.txt").write_text(f"{line}\n{line}\n")
    pairs = read_megadepth_1500(tmp_path)
    assert len(pairs) == 2
    assert_is_the_pair(pairs[1])
    assert pairs[0].image_b == tmp_path / "images/0022/2.png"


def test_megadepth_1500_of_xfeat(tmp_path, two_images):
    names = ["Undistorted_SfM/0015/images/1.png", "Undistorted_SfM/0015/images/2.png"]
    two_images(*(f"megadepth_test_1500/{name}" for name in names))
    entry = {
        "pair_names": names,
        "K0": K_A.tolist(),
        "K1": K_B.tolist(),
        "T_0to1": T_B_A.tolist(),
        "size0_hw": [24, 32],
        "size1_hw": [24, 32],
    }
    (tmp_path / "megadepth_1500.json").write_text(json.dumps([entry]))
    (pair,) = read_megadepth_1500(tmp_path)
    assert_is_the_pair(pair)
    assert pair.image_a == tmp_path / "megadepth_test_1500" / names[0]

    for broken in ({**entry, "pair_names": names[:1]}, {"pair_names": names}, 3):
        (tmp_path / "megadepth_1500.json").write_text(json.dumps([broken]))
        with pytest.raises(InputError, match="list of objects with pair_names, K0, K1 and T_0to1"):
            read_megadepth_1500(tmp_path)


def test_scannet_1500_of_superglue(tmp_path, two_images):
    two_images("scans/1.png", "scans/2.png")
    line = f"scans/1.png scans/2.png 0 0 {words(K_A, K_B, T_B_A)}\n"
    (tmp_path / "scannet_test_pairs_with_gt.txt").write_text(line)
    (pair,) = read_scannet_1500(tmp_path)
    assert_is_the_pair(pair)


def test_scannet_1500_of_loftr(tmp_path, two_images):
    two_images(*(f"scannet_test_1500/scene0707_00/color/{n}.jpg" for n in (15, 585)))
    scan = tmp_path / "scannet_test_1500" / "scene0707_00"
    for folder in ("pose", "intrinsic"):
        (scan / folder).mkdir()
    T_world_b = np.eye(4)
    T_world_b[:3, :3] = cv2.Rodrigues(np.array([0, 0, 0.4]))[0]
    T_world_b[:3, 3] = [3, 2, 1]
    np.savetxt(scan / "pose" / "15.txt", T_world_b @ T_B_A)
    np.savetxt(scan / "pose" / "585.txt", T_world_b)
    K = np.eye(4)
    K[:3, :3] = K_A
    np.savetxt(scan / "intrinsic" / "intrinsic_color.txt", K)
    np.savez(tmp_path / "test.npz", name=np.array([[707, 0, 15, 585]], np.uint16))
    (pair,) = read_scannet_1500(tmp_path)
    np.testing.assert_allclose(pair.T_b_a, T_B_A, atol=1e-9)
    np.testing.assert_allclose(pair.K_b, K_A)
    assert pair.image_b == scan / "color" / "585.jpg"

    np.savez(tmp_path / "test.npz", names=np.zeros((1, 4)))
    with pytest.raises(InputError, match="an array called name"):
        read_scannet_1500(tmp_path)


@pytest.mark.parametrize(
    ("read", "name"),
    [
        (read_megadepth_1500, "MegaDepth-1500"),
        (read_scannet_1500, "ScanNet-1500"),
        (read_hpatches, "HPatches"),
    ],
)
def test_missing_and_foreign_folders_are_refused(tmp_path, read, name):
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "image.png").write_text("")
    for folder in (tmp_path / "missing", tmp_path / "other"):
        with pytest.raises(InputError, match=name):
            read(folder)


def test_the_given_scannet_pairs_are_read(sfgs_data):
    pairs = read_scannet_1500(sfgs_data / "data" / "scannet_pairs")
    assert len(pairs) == 15
    assert pairs[0].K_a[0, 0] == pytest.approx(1163.45)
    for pair in pairs:
        np.testing.assert_allclose(np.linalg.det(pair.T_b_a), 1, atol=1e-3)
    (a, b), (K_a, _) = pairs[0].load(longest=640)
    assert a.shape == b.shape == (478, 640, 3)
    assert K_a[0, 0] == pytest.approx(1163.45 * 640 / 1296)


@pytest.fixture
def hpatches(tmp_path, write_image, images):
    """Two sequences of six images, where image n is image 1 moved by (n, -n)."""
    for sequence in ("i_dome", "v_talent"):
        for n in range(1, 7):
            write_image(tmp_path / sequence / f"{n}.ppm", images(64, 48)[0])
            if n > 1:
                np.savetxt(
                    tmp_path / sequence / f"H_1_{n}", 2 * np.array([[1, 0, n], [0, 1, -n], [0, 0, 1.0]])
                )
    return tmp_path


def test_hpatches(hpatches):
    pairs = read_hpatches(hpatches)
    assert [pair.name for pair in pairs[:2]] == ["i_dome/1-2", "i_dome/1-3"]
    assert [pair.group for pair in pairs] == ["illumination"] * 5 + ["viewpoint"] * 5
    last = pairs[-1]
    assert (last.image_a, last.image_b) == (hpatches / "v_talent/1.ppm", hpatches / "v_talent/6.ppm")
    np.testing.assert_allclose(last.H_b_a, [[1, 0, 6], [0, 1, -6], [0, 0, 1]])
    assert len(read_hpatches(hpatches, exclude=HPATCHES_LARGE)) == 5
    (a, b), H_b_a = last.load(longest=32)
    assert a.shape == b.shape == (24, 32, 3)
    np.testing.assert_allclose(H_b_a, [[1, 0, 3], [0, 1, -3], [0, 0, 1]])


def test_broken_sequences_of_hpatches_are_refused(hpatches):
    np.savetxt(hpatches / "i_dome" / "H_1_3", np.ones((3, 3)))
    with pytest.raises(InputError, match=r"H_1_3 should hold an invertible 3x3"):
        read_hpatches(hpatches)
    (hpatches / "i_dome" / "2.ppm").unlink()
    with pytest.raises(InputError, match=r"2\.ppm is missing"):
        read_hpatches(hpatches)


def test_a_homography_between_images_shrunk_differently(tmp_path, write_image, images):
    write_image(tmp_path / "a.png", images(64, 48)[0])
    write_image(tmp_path / "b.png", images(32, 24)[0])
    pair = HomographyPair("", "viewpoint", tmp_path / "a.png", tmp_path / "b.png", np.diag([0.5, 0.5, 1.0]))
    _, H_b_a = pair.load(longest=32)
    # Pixel (1, 1) of the shrunk image a is at (2.5, 2.5) of the file, so at (1.25, 1.25) of b.
    np.testing.assert_allclose(H_b_a @ [1, 1, 1], [1.25, 1.25, 1])
