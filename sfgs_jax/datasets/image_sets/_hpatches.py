"""HPatches: sequences of six photographs of a plane, with homographies from the first to the others.

Source: Balntas et al., HPatches: A benchmark and evaluation of handcrafted and learned local descriptors,
CVPR 2017.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sfgs_jax.arrays import InputError, checked
from sfgs_jax.datasets.files import read_numbers
from sfgs_jax.datasets.image_sets._image_pairs import HomographyPair

HPATCHES_LARGE = (
    "i_contruction",
    "i_crownnight",
    "i_dc",
    "i_pencils",
    "i_whitebuilding",
    "v_artisans",
    "v_astronautis",
    "v_talent",
)
"""Sequences whose images are so large that D2-Net and many after it leave them out."""

_GROUPS = {"i": "illumination", "v": "viewpoint"}
_OTHERS = range(2, 7)


@checked
def read_hpatches(folder: str | Path, *, exclude: Sequence[str] = ()) -> list[HomographyPair]:
    """The pairs (1, 2) to (1, 6) of every sequence of `hpatches-sequences-release`.

    Args:
        folder: holds a folder `i_NAME` or `v_NAME` for each sequence, with `1.ppm` to `6.ppm` and `H_1_2` to
            `H_1_6`.
        exclude: sequences to leave out; `HPATCHES_LARGE` makes the customary 108.

    Raises:
        InputError: the folder is missing or is none of HPatches, or a file is missing or broken.
    """
    folder = Path(folder).expanduser()
    sequences = sorted(
        path
        for path in (folder.iterdir() if folder.is_dir() else ())
        if path.is_dir() and path.name[:2] in ("i_", "v_") and path.name not in exclude
    )
    if not sequences:
        raise InputError(
            f"{folder} holds no sequences of HPatches: give the folder with i_ajuntament/, v_abstract/ and "
            "the others in it (hpatches-sequences-release)."
        )
    return [_pair(sequence, other) for sequence in sequences for other in _OTHERS]


def _pair(sequence: Path, other: int) -> HomographyPair:
    images = [sequence / f"{number}.ppm" for number in (1, other)]
    missing = [path for path in images if not path.is_file()]
    if missing:
        raise InputError(f"{missing[0]} is missing; each sequence of HPatches has 1.ppm to 6.ppm.")
    path = sequence / f"H_1_{other}"
    matrix = np.asarray([value for row in read_numbers(path) for value in row])
    if matrix.size != 9 or not np.isfinite(matrix).all() or abs(np.linalg.det(matrix.reshape(3, 3))) < 1e-12:
        raise InputError(f"{path} should hold an invertible 3x3 homography.")
    H_b_a = matrix.reshape(3, 3)
    return HomographyPair(
        name=f"{sequence.name}/1-{other}",
        group=_GROUPS[sequence.name[0]],
        image_a=images[0],
        image_b=images[1],
        H_b_a=H_b_a / H_b_a[2, 2],
    )
