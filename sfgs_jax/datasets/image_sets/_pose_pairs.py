"""Calibrated pairs for relative pose: MegaDepth-1500, ScanNet-1500, and any list in their formats."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError, checked, described, excerpt, parsed_json, require_file
from sfgs_jax.datasets.files import listed_file, read_matrix_file, read_numbers, read_text
from sfgs_jax.datasets.image_sets._image_pairs import PosePair

# Names, rotation flags, two calibration matrices and a 4x4 motion: SuperGlue's lists.
_WITH_FLAGS = 2 + 2 + 9 + 9 + 16
# Names, two calibration matrices and a 3x4 motion (rotation, then translation) or a 4x4 one: glue-factory's.
_WITHOUT_FLAGS = (2 + 9 + 9 + 12, 2 + 9 + 9 + 16)


@checked
def read_pair_list(path: str | Path, images: str | Path | None = None) -> list[PosePair]:
    """The pairs of a text file with one pair a line.

    A line is `name_a name_b [flag_a flag_b] K_a(9) K_b(9) T_b_a`, matrices row by row. T_b_a has 16
    numbers, or 12: rotation (9) and then translation (3).

    Args:
        path: the list.
        images: folder that the names are relative to; by default the folder of the list.

    Raises:
        InputError: the list can't be read, a line is no pair, an image is missing or is to be rotated.
    """
    path = Path(path).expanduser()
    root = path.parent if images is None else Path(images).expanduser()
    lines = [(n, line.split()) for n, line in enumerate(read_text(path).splitlines(), start=1)]
    pairs = [_parse(path, n, words, root) for n, words in lines if words]
    return _checked(pairs, path)


@checked
def read_megadepth_1500(folder: str | Path) -> list[PosePair]:
    """MegaDepth-1500 in the layout of glue-factory or of XFeat.

    Args:
        folder: holds `pairs_calibrated.txt` and `images/`, or `megadepth_1500.json` and
            `megadepth_test_1500/`.

    Raises:
        InputError: the folder is missing or another one, or a file is missing or broken.
    """
    folder = Path(folder).expanduser()
    if (folder / "pairs_calibrated.txt").is_file():
        return read_pair_list(folder / "pairs_calibrated.txt", folder / "images")
    listing = folder / "megadepth_1500.json"
    if listing.is_file():
        return _read_json(listing, folder / "megadepth_test_1500")
    raise InputError(
        f"{folder} is no MegaDepth-1500: it has neither pairs_calibrated.txt (with images/) nor "
        "megadepth_1500.json (with megadepth_test_1500/). LoFTR's scene_info files hold pickled objects, "
        "which are not read."
    )


@checked
def read_scannet_1500(folder: str | Path) -> list[PosePair]:
    """ScanNet-1500 in the layout of SuperGlue or of LoFTR; or other pairs in SuperGlue's format.

    Args:
        folder: holds `scannet_test_pairs_with_gt.txt` or `pairs_with_gt.txt` and the images that it names; or
            `test.npz` and `scannet_test_1500/sceneXXXX_XX/` with `color/`, `pose/` and `intrinsic/`.

    Raises:
        InputError: the folder is missing or another one, or a file is missing or broken.
    """
    folder = Path(folder).expanduser()
    for name in ("scannet_test_pairs_with_gt.txt", "pairs_with_gt.txt"):
        if (folder / name).is_file():
            return read_pair_list(folder / name)
    if (folder / "test.npz").is_file():
        return _read_loftr(folder / "test.npz", folder / "scannet_test_1500")
    raise InputError(
        f"{folder} is no ScanNet-1500: it has none of scannet_test_pairs_with_gt.txt, pairs_with_gt.txt and "
        "test.npz (with scannet_test_1500/)."
    )


def _parse(path: Path, number: int, words: list[str], root: Path) -> PosePair:
    flagged = len(words) == _WITH_FLAGS
    if not flagged and len(words) not in _WITHOUT_FLAGS:
        raise InputError(
            f"{path}, line {number}: a pair has {_WITH_FLAGS} words, or {_WITHOUT_FLAGS[0]} or "
            f"{_WITHOUT_FLAGS[1]} without rotation flags, not {len(words)}."
        )
    try:
        numbers = np.asarray([float(word) for word in words[2:]])
    except ValueError:
        raise InputError(f"{path}, line {number}: expected numbers after the two names.") from None
    if flagged and numbers[:2].any():
        raise InputError(f"{path}, line {number}: the images are to be rotated, which is not supported.")
    numbers = numbers[2:] if flagged else numbers
    motion = numbers[18:]
    if len(motion) == 12:
        motion = np.concatenate([motion[:9].reshape(3, 3), motion[9:, None]], axis=1)
    return _pair(
        f"{path}, line {number}",
        (words[0], words[1]),
        root,
        numbers[:9].reshape(3, 3),
        numbers[9:18].reshape(3, 3),
        motion.reshape(-1, 4),
    )


def _read_json(path: Path, root: Path) -> list[PosePair]:
    try:
        entries = parsed_json(read_text(path))
        pairs = [
            _pair(
                f"{path}, entry {i}",
                tuple(entry["pair_names"]),
                root,
                *(np.asarray(entry[key], np.float64) for key in ("K0", "K1", "T_0to1")),
            )
            for i, entry in enumerate(entries)
        ]
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise InputError(
            f"{path} should be a list of objects with pair_names, K0, K1 and T_0to1: {excerpt(error)}."
        ) from error
    return _checked(pairs, path)


def _read_loftr(path: Path, root: Path) -> list[PosePair]:
    try:
        require_file(path)
        with np.load(path, allow_pickle=False) as archive:
            names = np.asarray(archive["name"])
    except Exception as error:  # NumPy's reader raises whatever a broken archive trips
        raise InputError(f"{path} should hold an array called name: {excerpt(error)}.") from error
    if names.ndim != 2 or names.shape[1] != 4 or names.dtype.kind not in "iu":
        raise InputError(f"{path}: name is {described(names)}, not whole numbers of shape (pairs, 4).")
    pairs = []
    for scene, scan, *frames in names.tolist():
        folder = root / f"scene{scene:04d}_{scan:02d}"
        K = _calibration(folder / "intrinsic" / "intrinsic_color.txt")
        T_world_a, T_world_b = (read_matrix_file(folder / "pose" / f"{frame}.txt") for frame in frames)
        images = (f"{folder.name}/color/{frames[0]}.jpg", f"{folder.name}/color/{frames[1]}.jpg")
        pairs.append(_pair(str(path), images, root, K, K, np.linalg.inv(T_world_b) @ T_world_a))
    return _checked(pairs, path)


def _calibration(path: Path) -> Float[np.ndarray, "3 3"]:
    rows = read_numbers(path)
    if len(rows) not in (3, 4) or any(len(row) != len(rows) for row in rows):
        raise InputError(f"{path} should hold a 3x3 or 4x4 calibration matrix.")
    return np.asarray(rows)[:3, :3]


def _pair(
    where: str,
    names: tuple[str, ...],
    root: Path,
    K_a: Float[np.ndarray, "*shape_a"],
    K_b: Float[np.ndarray, "*shape_b"],
    T_b_a: Float[np.ndarray, "*shape_t"],
) -> PosePair:
    """A pair from matrices that may have any shape or values; InputError names the place in the list."""
    full = np.eye(4)
    full[:3] = T_b_a[:3]
    shapes_fit = K_a.shape == K_b.shape == (3, 3) and T_b_a.shape in ((3, 4), (4, 4))
    if not shapes_fit or not all((np.abs(x) < 1e9).all() for x in (K_a, K_b, full)):
        raise InputError(f"{where}: the calibration or the motion is not finite.")
    rotation = full[:3, :3]
    is_rotation = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-2) and np.linalg.det(rotation) > 0
    if not is_rotation or not full[:3, 3].any():
        raise InputError(f"{where}: the motion should be a rotation and a translation that is not zero.")
    if not all(1e-3 < focal < 1e9 for K in (K_a, K_b) for focal in (K[0, 0], K[1, 1])):
        raise InputError(f"{where}: the focal lengths should be positive, in pixels.")
    first, second = (listed_file(root, name, where) for name in names)
    return PosePair(name=" ".join(names), image_a=first, image_b=second, K_a=K_a, K_b=K_b, T_b_a=full)


def _checked(pairs: list[PosePair], listing: Path) -> list[PosePair]:
    if not pairs:
        raise InputError(f"{listing} lists no pairs.")
    images = {path for pair in pairs for path in (pair.image_a, pair.image_b)}
    missing = sorted(path for path in images if not path.is_file())
    if missing:
        raise InputError(
            f"{len(missing)} of the {len(images)} images of {listing} are missing, the first is {missing[0]}."
        )
    return pairs
