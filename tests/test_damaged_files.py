"""Damaged and hostile files: each is refused in one short sentence, or read as something that makes sense."""

import json
import os
import zlib

import numpy as np
import pytest

from experiments.fuzz import fuzzed, outcome
from experiments.fuzz_formats import formats
from sfgs_jax import gicp, splatting
from sfgs_jax.arrays import FrameError, InputError, excerpt, file_bytes, file_text, parsed_json
from sfgs_jax.cli import read_config
from sfgs_jax.datasets import ReaderOptions, open_recording, read_pair_list
from sfgs_jax.datasets.files import decode_colour, decode_depth, rigid_poses

FORMATS = formats()
INPUTS = 8


@pytest.mark.parametrize("name", [name for name in FORMATS if name not in ("7scenes", "weights")])
def test_damaged_inputs_are_refused_or_make_sense(name):
    defects = [row[:3] for row in fuzzed(name, FORMATS[name], INPUTS, 1) if row[0] not in ("ok", "refused")]
    assert not defects


@pytest.fixture
def tum(tmp_path):
    for path, content in FORMATS["tum"].files.items():
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_bytes(content)
    assert outcome(FORMATS["tum"], tmp_path) == ("ok", "")
    return tmp_path


@pytest.mark.parametrize(
    "name", ["/etc/hostname", "../outside.png", "rgb/../../x.png", "rgb/\0.png", "y" * 400, "/dev/zero", "."]
)
def test_a_list_does_not_lead_out_of_its_folder(tum, name):
    (tum / "rgb.txt").write_text(f"0.0 {name}\n")
    with pytest.raises(InputError, match=r"rgb\.txt names .* lies outside") as caught:
        open_recording(tum)
    assert len(str(caught.value).replace(str(tum), "")) < 300


def test_links_are_followed_but_only_to_files(tum, tmp_path_factory):
    other = tmp_path_factory.mktemp("elsewhere") / "0.png"
    (tum / "rgb/0.png").rename(other)
    (tum / "rgb/0.png").symlink_to(other)
    (tum / "rgb/1.png").unlink()
    os.mkfifo(tum / "rgb/1.png")
    recording = open_recording(tum)
    assert recording[0].rgb.shape == (16, 24, 3)
    with pytest.raises(FrameError, match="no regular file"):
        recording[1]
    (tum / "rgb/1.png").unlink()
    (tum / "rgb/1.png").symlink_to("/dev/zero")
    with pytest.raises(FrameError, match="no regular file"):
        recording[1]


def _png_header(width: int, height: int) -> bytes:
    chunk = b"IHDR" + width.to_bytes(4, "big") + height.to_bytes(4, "big") + bytes([16, 0, 0, 0, 0])
    end = b"\0\0\0\0IEND" + zlib.crc32(b"IEND").to_bytes(4, "big")
    return b"\x89PNG\r\n\x1a\n" + b"\0\0\0\x0d" + chunk + zlib.crc32(chunk).to_bytes(4, "big") + end


def test_no_room_is_made_for_what_a_header_promises(tmp_path):
    for size in ((30_000, 30_000), (9_000, 9_000), (2**31 - 1, 2**31 - 1)):
        (tmp_path / "bomb.png").write_bytes(_png_header(*size))
        with pytest.raises(FrameError, match=r"bomb\.png has .*pixels"):
            decode_colour(tmp_path / "bomb.png")
    header = b"{'descr': '<f4', 'fortran_order': False, 'shape': (99999999999, 999), }\n"
    npy = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
    for content in (npy, npy.replace(b"<f4", b"|O8"), npy.replace(b"{", b"\x7b\x00"), npy[:20], b""):
        (tmp_path / "depth.npy").write_bytes(content)
        with pytest.raises(FrameError, match="cannot be read as an array"):
            decode_depth(tmp_path / "depth.npy", None)
    with (tmp_path / "sparse.png").open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(FrameError, match="more than it can need"):
        decode_colour(tmp_path / "sparse.png")


@pytest.mark.parametrize(
    "text",
    [
        '{"fx": null, "fy": 20, "cx": 11, "cy": 7}',
        '{"fx": -20, "fy": 20, "cx": 11, "cy": 7}',
        '{"fx": 1e999, "fy": 20, "cx": 11, "cy": 7}',
        '{"fx": 20, "fx": 30, "fy": 20, "cx": 11, "cy": 7}',
        '{"fx": 20, "fy": 20, "cx": 11, "cy": 7, "width": 24.5}',
        '{"fx": 20, "fy": 20, "cx": 11, "cy": 7, "distortion": [true, true, true, true]}',
        '{"fx": NaN, "fy": 20, "cx": 11, "cy": 7}',
        '{"fx": 20, "fy": 20, "cx": 11, "cy": 7, "depth_scale": 1e-320}',
        '{"fx": %s, "fy": 20, "cx": 11, "cy": 7}' % ("9" * 5000),
        '{"fx": "%s", "fy": 20, "cx": 11, "cy": 7}' % ("x" * 100_000),
        "[" * 100_000,
    ],
)
def test_a_camera_that_is_none_is_refused(tum, text):
    (tum / "camera.json").write_text(text)
    with pytest.raises(InputError, match=r"camera\.json") as caught:
        open_recording(tum)
    assert len(str(caught.value).replace(str(tum), "")) < 300


def test_intrinsics_of_a_layout_are_checked(tmp_path):
    kind = FORMATS["replica"]
    for path, content in kind.files.items():
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_bytes(content)
    camera = json.loads(kind.files["cam_params.json"])["camera"]
    for change, message in (
        ({"fx": -20.0}, "focal lengths"),
        ({"fx": float("inf")}, "focal lengths"),
        ({"w": 1e999}, "does not hold"),
        ({"scale": 1e-320}, "depth scale"),
    ):
        (tmp_path / "cam_params.json").write_text(json.dumps({"camera": camera | change}))
        with pytest.raises(InputError, match=message):
            open_recording(tmp_path)
    open_recording(tmp_path, options=ReaderOptions(depth_scale=1000.0, camera=_own_camera(tmp_path)))


def _own_camera(folder):
    (folder / "own.json").write_text('{"fx": 20, "fy": 20, "cx": 11.5, "cy": 7.5}')
    return folder / "own.json"


@pytest.mark.parametrize(
    "content",
    ["{}é".encode("latin-1"), '{"source": 1}'.encode("utf-16"), b"[" * 100_000, b'{"slam": 1}', b"\0"],
)
def test_a_configuration_that_is_none_is_refused(tmp_path, content):
    (tmp_path / "config.json").write_bytes(content)
    with pytest.raises(InputError, match=r"config\.json") as caught:
        read_config(tmp_path / "config.json")
    assert len(str(caught.value)) < 400


def test_points_and_maps_with_impossible_numbers_are_refused(tmp_path):
    (tmp_path / "p.xyz").write_text("0 0 0\nnan 0 0\n0 1 0\n")
    with pytest.raises(InputError, match="not finite"):
        gicp.load_points(tmp_path / "p.xyz")
    content = FORMATS["splat PLY"].files["map.ply"]
    (tmp_path / "map.ply").write_bytes(content.replace(b"vertex 8", b"vertex 7"))
    with pytest.raises(InputError, match="more than its header says"):
        splatting.load_ply(tmp_path / "map.ply")
    (tmp_path / "map.ply").write_bytes(content[:-8] + np.float32(1e30).tobytes() + content[-4:])
    with pytest.raises(InputError, match="quaternions hold values beyond"):
        splatting.load_ply(tmp_path / "map.ply")


SINGLE = [name for name, kind in FORMATS.items() if len(kind.files) == 1 and name != "SPZ, within gzip"]


@pytest.mark.parametrize("name", SINGLE)
def test_what_is_no_regular_file_is_refused_at_once(tmp_path, name):
    kind = FORMATS[name]
    path = tmp_path / kind.targets[0]
    path.parent.mkdir(exist_ok=True)
    os.mkfifo(path)
    assert outcome(kind, tmp_path)[0] == "refused"
    for other in ("/dev/zero", path.name, "nowhere", tmp_path):
        path.unlink()
        path.symlink_to(other)
        found, message = outcome(kind, tmp_path)
        # A run without a table of its frames has none.
        assert found == ("ok" if name == "frames.csv" and other in (path.name, "nowhere") else "refused")
        assert str(tmp_path) in message or found == "ok"


def test_files_are_read_up_to_a_size(tmp_path):
    path = tmp_path / "a.txt"
    path.write_bytes(b"\xef\xbb\xbfa\r\nb\rc")
    assert file_text(path) == "a\nb\nc"
    assert file_bytes(path, 9) == path.read_bytes()
    with pytest.raises(ValueError, match="9 bytes, more than it can need"):
        file_bytes(path, 8)
    with path.open("ab") as file:
        file.truncate(1 << 40)
    for read in (file_text, file_bytes):
        with pytest.raises(ValueError, match="more than it can need"):
            read(path)
    # The kernel's log says that it is an empty file, and never ends.
    assert file_bytes("/proc/version") == b""


@pytest.mark.parametrize("text", ["[" * 100_000, '{"a": 1, "a": 2}', '{"a": ' + "9" * 5000 + "}", '{"a"'])
def test_json_that_means_nothing_is_refused(text):
    with pytest.raises(ValueError, match=r"too many levels|two entries 'a'|limit|delimiter"):
        parsed_json(text)


def test_entries_that_name_no_file_are_refused(tmp_path):
    kind = FORMATS["nerfstudio"]
    for path, content in kind.files.items():
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_bytes(content)
    content = json.loads(kind.files["transforms.json"])
    for name in ("\ud800.png", "9" * 5000 + ".png", "a\0.png"):
        content["frames"][1]["file_path"] = name
        (tmp_path / "transforms.json").write_text(json.dumps(content))
        with pytest.raises(InputError, match="lies outside"):
            open_recording(tmp_path)


def test_messages_can_be_shown_by_any_terminal():
    text = str(InputError("\x1b[31m a\n b \udcff \u202e é " + "x" * 10_000))
    assert text.startswith(r"\x1b[31m a\n b \udcff \u202e é xxx")
    assert len(text) == 5000


def test_a_matrix_that_is_no_rigid_motion_is_no_pose():
    good = np.eye(4)
    wrong = np.stack([np.diag([1.0, 1, -1, 1]), 2 * good, good, good, good])
    wrong[2, 3], wrong[3, 3, 0], wrong[4, 0, 3] = 0, 5, 1e30
    poses = rigid_poses(np.concatenate([good[None], wrong]))
    np.testing.assert_array_equal(poses[0], good)
    assert np.isnan(poses[1:]).all()


def test_pairs_of_mirrored_images_are_refused(tmp_path):
    kind = FORMATS["pair list"]
    for path, content in kind.files.items():
        (tmp_path / path).write_bytes(content)
    mirrored = kind.files["pairs.txt"].replace(b"1 0 0 0.5 0 1 0 0", b"-1 0 0 0.5 0 1 0 0")
    (tmp_path / "pairs.txt").write_bytes(mirrored)
    with pytest.raises(InputError, match="should be a rotation"):
        read_pair_list(tmp_path / "pairs.txt")


def test_quotes_are_short():
    assert excerpt("a 'b'\n") == "\"a 'b'\\n\""
    for value in (
        "x" * 10**6,
        [[[[[1]]]]] * 1000,
        {"a": "y" * 1000},
        ValueError("z\n" * 1000),
        OSError(28, "No"),
    ):
        assert len(excerpt(value)) <= 100
        assert "\n" not in excerpt(value)
    assert excerpt(KeyError("fx")) == "'fx' is missing"
    assert excerpt(RecursionError("maximum recursion depth")) == "too many levels"
