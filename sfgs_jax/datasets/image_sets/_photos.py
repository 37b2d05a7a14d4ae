"""Folders of photographs to train keypoints on."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError, checked
from sfgs_jax.datasets.files import COLOUR_SUFFIXES, decode_colour, images_in, natural_key


@dataclass(frozen=True)
class Photos:
    """Photographs, decoded when asked for.

    Attributes:
        paths: the files.
    """

    paths: tuple[Path, ...]

    def __len__(self) -> int:
        return len(self.paths)

    def __getitem__(self, index: int) -> Float[np.ndarray, "h w 3"]:
        """RGB in [0, 1]. Raises FrameError for a file that can't be decoded."""
        return decode_colour(self.paths[index])


def _coco(folder: Path) -> Iterable[Path]:
    """`train2017/*.jpg`, or `images/train2017/*.jpg`; 2014 likewise."""
    for parent in (folder, folder / "images"):
        for split in ("train2017", "train2014"):
            if found := images_in(parent / split, (".jpg",)):
                return found
    return ()


def _megadepth(folder: Path) -> Iterable[Path]:
    """`0015/dense0/imgs/*.jpg` of each scene, below the folder or its `phoenix/S6/zl548/MegaDepth_v1`."""
    for root in (folder, folder / "phoenix" / "S6" / "zl548" / "MegaDepth_v1"):
        scenes = sorted(root.glob("[0-9][0-9][0-9][0-9]/dense*/imgs"))
        if found := [path for scene in scenes for path in images_in(scene, COLOUR_SUFFIXES)]:
            return found
    return ()


def _folder(folder: Path) -> Iterable[Path]:
    """Every image in the folder and in the folders below it."""
    below = sorted(
        (path for path in folder.rglob("*") if path.is_dir()),
        key=lambda path: natural_key(path.relative_to(folder).as_posix()),
    )
    return [path for each in (folder, *below) for path in images_in(each, COLOUR_SUFFIXES)]


_LAYOUTS: dict[str, tuple[Callable[[Path], Iterable[Path]], str]] = {
    "coco": (_coco, "train2017/ with .jpg files"),
    "megadepth": (_megadepth, "0015/dense0/imgs/ and the like"),
    "folder": (_folder, "images"),
}

PHOTO_LAYOUTS = tuple(_LAYOUTS)
"""Names of the layouts, the possible values of `layout`."""


@checked
def read_photos(folder: str | Path, *, layout: str = "folder") -> Photos:
    """Photographs of COCO's or MegaDepth's training set, or of any folder, always in the same order.

    Args:
        folder: the set's folder, unpacked.
        layout: one of `PHOTO_LAYOUTS`.

    Raises:
        InputError: the layout is unknown, the folder is missing, or nothing of that layout lies there.
    """
    if layout not in _LAYOUTS:
        raise InputError(f"There is no layout {layout!r} of photographs; choose from {', '.join(_LAYOUTS)}.")
    folder = Path(folder).expanduser()
    if not folder.is_dir():
        raise InputError(f"There is no folder {folder}.")
    find, marks = _LAYOUTS[layout]
    paths = tuple(find(folder))
    if not paths:
        raise InputError(f"{folder} holds no photographs in the layout {layout!r}: there is no {marks}.")
    return Photos(paths)
