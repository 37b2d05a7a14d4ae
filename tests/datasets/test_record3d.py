"""Captures of Record3D: an archive of images, compressed depth, and ARKit's poses."""

import json
import sys
import zipfile
import zlib
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from sfgs_jax.arrays import FrameError, InputError
from sfgs_jax.datasets import ReaderOptions, open_recording
from sfgs_jax.datasets.files import decompress_lzfse
from sfgs_jax.geometry import quaternions_from_rotations

# "abc" and zeros in a block without compression, and the end of the stream.
LZFSE_BLOCK = b"bvx-" + (8).to_bytes(4, "little") + b"abc\0\0\0\0\0" + b"bvx$"


@pytest.fixture(autouse=True)
def codec(monkeypatch):
    """Another compression in LZFSE's place, since that package is optional."""
    monkeypatch.setitem(
        sys.modules, "liblzfse", SimpleNamespace(decompress=zlib.decompress, error=zlib.error)
    )


@pytest.fixture
def members(room, capture) -> dict[str, bytes]:
    """The files of a capture."""
    files = {}
    poses = []
    for n, frame in enumerate(capture):
        ok, jpeg = cv2.imencode(".png", cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2BGR))
        assert ok
        files[f"rgbd/{n}.jpg"] = jpeg.tobytes()
        files[f"rgbd/{n}.depth"] = zlib.compress(frame.depth.tobytes())
        files[f"rgbd/{n}.conf"] = zlib.compress(np.full(frame.depth.shape, 2, np.uint8).tobytes())
        opengl = frame.pose @ np.diag([1, -1, -1, 1])
        w, x, y, z = quaternions_from_rotations(opengl[None, :3, :3])[0]
        poses.append([x, y, z, w, *opengl[:3, 3]])
    metadata = {
        "K": np.asarray(room.camera.matrix(), float).T.ravel().tolist(),
        "w": room.width,
        "h": room.height,
        "fps": 60,
        "poses": poses,
        "frameTimestamps": [20.0 + n / 50 for n in range(len(capture))],
    }
    files["metadata"] = json.dumps(metadata).encode()
    return files


@pytest.fixture
def write(tmp_path, members):
    """Writes the archive, after changes to its metadata and files."""

    def make(metadata: dict | None = None, **files: bytes | None):
        changed = {**json.loads(members["metadata"]), **(metadata or {})}
        content = {**members, "metadata": json.dumps(changed).encode(), **files}
        path = tmp_path / "desk.r3d"
        with zipfile.ZipFile(path, "w") as archive:
            for name, data in content.items():
                if data is not None:
                    archive.writestr(name, data)
        return path

    return make


def test_images_poses_and_intrinsics(write, check_capture):
    recording = open_recording(write())
    check_capture(recording, dataset="record3d", step=1e-5)
    assert recording.name == "desk"
    np.testing.assert_allclose(recording.timestamps, 20 + np.arange(5) / 50)


def test_an_unpacked_archive(write, tmp_path, check_capture):
    with zipfile.ZipFile(write()) as archive:
        archive.extractall(tmp_path / "desk")
    check_capture(open_recording(tmp_path / "desk"), dataset="record3d", step=1e-5)


def test_without_time_stamps_and_confidence(write):
    recording = open_recording(write({"frameTimestamps": []}, **{"rgbd/1.conf": None}))
    np.testing.assert_allclose(recording.timestamps, np.arange(5) / 60)
    assert (recording[1].depth > 0).all()


def test_depth_of_low_confidence_is_missing(write, capture):
    levels = np.zeros(capture[0].depth.shape, np.uint8)
    levels[15:] = 2
    path = write(**{"rgbd/2.conf": zlib.compress(levels.tobytes())})
    np.testing.assert_array_equal((open_recording(path)[2].depth > 0).all(axis=1), np.arange(60) >= 30)
    assert (open_recording(path, options=ReaderOptions(min_confidence=0))[2].depth > 0).all()


def test_damaged_frames_are_frame_errors(write):
    path = write(
        **{
            "rgbd/1.depth": b"no depth",
            "rgbd/2.depth": zlib.compress(b"1234567"),
            "rgbd/3.depth": None,
            "rgbd/4.jpg": b"\xff\xd8",
        }
    )
    recording = open_recording(path)
    recording[0]
    for n, words in ((1, "damaged"), (2, "holds 7 bytes"), (3, "is missing"), (4, "truncated")):
        with pytest.raises(FrameError, match=words):
            recording[n]


def test_numbers_that_no_capture_has_are_passed_over(write):
    path = write({"frameTimestamps": []}, **{f"rgbd/{'9' * count}.jpg": b"" for count in (9, 5000)})
    assert len(open_recording(path)) == 5


def test_members_larger_than_images_are_not_read(write):
    path = write(**{"rgbd/1.depth": bytes((1 << 24) + 1)})
    with pytest.raises(FrameError, match="more than it can need"):
        open_recording(path)[1]


@pytest.mark.parametrize(
    ("metadata", "message"),
    [
        ({"K": [1, 2]}, "does not describe a Record3D capture"),
        ({"w": None}, "does not describe a Record3D capture"),
        ({"poses": "none"}, "does not describe a Record3D capture"),
        ({"w": 0}, "w and h must be from 1 to 16384"),
        ({"w": 1e300}, "w and h must be from 1 to 16384"),
        ({"fps": float("inf")}, "fps above 0"),
        ({"frameTimestamps": [1, 2, float("nan"), 4, 5]}, "frameTimestamps must be finite"),
        ({"frameTimestamps": [1, 2, 2, 4, 5]}, "time stamps in .*metadata do not increase"),
        ({"K": [float("nan")] * 9}, "focal lengths"),
        ({"w": 160, "h": 120}, "are for 160x120 images, but the images are 80x60"),
    ],
)
def test_metadata_that_cannot_be_used(write, metadata, message):
    with pytest.raises(InputError, match=message) as caught:
        open_recording(write(metadata))
    assert len(str(caught.value).splitlines()) == 1


def test_archives_that_cannot_be_used(write, tmp_path):
    path = write(metadata=None, **{f"rgbd/{n}.jpg": None for n in range(5)})
    with pytest.raises(InputError, match="No pairs of colour and depth"):
        open_recording(path)
    path.write_bytes(b"no archive")
    with pytest.raises(InputError, match=r"cannot be read as an \.r3d archive"):
        open_recording(path)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("rgbd/0.jpg", b"")
    with pytest.raises(InputError, match=r"desk\.r3d/metadata is missing"):
        open_recording(path)
    with pytest.raises(InputError, match="no tum recording"):
        open_recording(path, dataset="tum")


def test_without_the_codec_one_sentence_says_how_to_get_it(write, monkeypatch):
    monkeypatch.setitem(sys.modules, "liblzfse", None)
    with pytest.raises(InputError, match=r"pip install 'sfgs-jax\[record3d\]'"):
        open_recording(write())


def test_the_codec_itself(monkeypatch):
    monkeypatch.delitem(sys.modules, "liblzfse")
    pytest.importorskip("liblzfse")
    assert decompress_lzfse(LZFSE_BLOCK, "block") == b"abc\0\0\0\0\0"
    with pytest.raises(FrameError, match="block is not compressed with LZFSE"):
        decompress_lzfse(b"nothing", "block")


def test_an_archive_of_another_version_of_zip(write):
    path = write()
    content = path.read_bytes()
    # The version that is needed to extract, in the last entry of the directory.
    place = content.rfind(b"PK\x01\x02") + 6
    path.write_bytes(content[:place] + b"\xff\x00" + content[place + 2 :])
    with pytest.raises(InputError, match=r"cannot be read as an \.r3d archive: zip file version 25\.5"):
        open_recording(path)


def test_an_image_that_is_narrower_than_a_pixel(write):
    one = {f"rgbd/{n}.depth": zlib.compress(bytes(4)) for n in range(5)}
    with pytest.raises(InputError, match="are for 1x16384 images"):
        open_recording(write({"w": 1, "h": 16384}, **one, **{f"rgbd/{n}.conf": None for n in range(5)}))
