"""Photographs in the layouts of COCO and MegaDepth, and in any folder."""

import numpy as np
import pytest

from sfgs_jax.arrays import FrameError, InputError
from sfgs_jax.datasets import PHOTO_LAYOUTS, read_photos


@pytest.fixture
def write(tmp_path, write_image, images):
    def write_all(*names: str) -> None:
        for name in names:
            write_image(tmp_path / name, images(32, 24)[0])

    return write_all


def names(photos, root) -> list[str]:
    return [path.relative_to(root).as_posix() for path in photos.paths]


@pytest.mark.parametrize("parent", ["", "images/"])
def test_coco(tmp_path, write, parent):
    write(
        f"{parent}train2017/000000000009.jpg", f"{parent}train2017/000000000025.jpg", f"{parent}val2017/1.jpg"
    )
    photos = read_photos(tmp_path, layout="coco")
    assert names(photos, tmp_path / parent) == ["train2017/000000000009.jpg", "train2017/000000000025.jpg"]
    image = photos[1]
    assert image.shape == (24, 32, 3)
    assert image.dtype == np.float32
    assert 0 <= image.min() < image.max() <= 1


@pytest.mark.parametrize("parent", ["", "phoenix/S6/zl548/MegaDepth_v1/"])
def test_megadepth(tmp_path, write, parent):
    write(
        *(
            f"{parent}{name}"
            for name in ("0022/dense0/imgs/a.jpg", "0015/dense1/imgs/b.jpg", "0015/other/c.jpg")
        )
    )
    photos = read_photos(tmp_path, layout="megadepth")
    assert names(photos, tmp_path / parent) == ["0015/dense1/imgs/b.jpg", "0022/dense0/imgs/a.jpg"]


def test_a_folder_with_folders_in_it(tmp_path, write):
    write("10.png", "9.jpg", "more/deep/1.webp", "more/2.png")
    (tmp_path / "notes.txt").write_text("")
    (tmp_path / "broken.jpg").write_bytes(b"\xff\xd8")
    photos = read_photos(tmp_path)
    assert names(photos, tmp_path) == ["9.jpg", "10.png", "broken.jpg", "more/2.png", "more/deep/1.webp"]
    assert len(photos) == 5
    with pytest.raises(FrameError, match="truncated"):
        photos[2]


@pytest.mark.parametrize("layout", PHOTO_LAYOUTS)
def test_missing_and_foreign_folders_are_refused(tmp_path, layout):
    with pytest.raises(InputError, match="There is no folder"):
        read_photos(tmp_path / "missing", layout=layout)
    with pytest.raises(InputError, match=f"no photographs in the layout '{layout}'"):
        read_photos(tmp_path, layout=layout)


def test_unknown_layouts_are_refused(tmp_path):
    with pytest.raises(InputError, match="choose from coco, megadepth, folder"):
        read_photos(tmp_path, layout="imagenet")


def test_the_given_photographs_are_read(sfgs_data):
    assert len(read_photos(sfgs_data / "data" / "photos" / "bsds")) == 300
