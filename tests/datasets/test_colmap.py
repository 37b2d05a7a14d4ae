"""COLMAP's models with depth maps of a sensor, and with its own."""

import struct

import numpy as np
import pytest

from sfgs_jax.arrays import FrameError, InputError
from sfgs_jax.datasets import open_recording
from sfgs_jax.geometry import quaternions_from_rotations

SCALE = "COLMAP's poses have a scale of their own: errors are in metres only if that was set."


class Model:
    """Writes a model, as text or binary."""

    def __init__(self, room, capture) -> None:
        camera = room.camera
        self.size = (room.width, room.height)
        self.model = (1, "PINHOLE")
        self.parameters = [float(camera.fx), float(camera.fy), float(camera.cx) + 0.5, float(camera.cy) + 0.5]
        self.images = []
        for n, frame in enumerate(capture):
            T = np.linalg.inv(frame.pose)
            quaternion = quaternions_from_rotations(T[None, :3, :3])[0]
            self.images.append((n + 1, [*quaternion, *T[:3, 3]], f"{n}.png", 3 * (n % 2)))

    def write_text(self, folder) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        width, height = self.size
        numbers = " ".join(map(str, self.parameters))
        (folder / "cameras.txt").write_text(f"# cameras\n7 {self.model[1]} {width} {height} {numbers}\n")
        lines = ["# images"]
        for key, pose, name, num_points in self.images:
            lines.append(" ".join([str(key), *map(repr, map(float, pose)), "7", name]))
            lines.append("1.5 2.5 -1 " * num_points)
        (folder / "images.txt").write_text("\n".join(lines) + "\n")

    def write_binary(self, folder) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        camera = struct.pack("<QiiQQ", 1, 7, self.model[0], *self.size)
        camera += struct.pack(f"<{len(self.parameters)}d", *self.parameters)
        (folder / "cameras.bin").write_bytes(camera)
        images = struct.pack("<Q", len(self.images))
        for key, pose, name, num_points in self.images:
            images += struct.pack("<I7dI", key, *pose, 7) + name.encode() + b"\0"
            images += struct.pack("<Q", num_points) + bytes(24 * num_points)
        (folder / "images.bin").write_bytes(images)


@pytest.fixture
def model(room, capture):
    return Model(room, capture)


@pytest.fixture
def desk(tmp_path, capture, model, write_image):
    """A folder with images, a sensor's depth, and a model as text."""
    folder = tmp_path / "desk"
    for n, frame in enumerate(capture):
        write_image(folder / f"images/{n}.png", frame.rgb)
        write_image(folder / f"depth/{n}.png", np.round(frame.depth * 1000).astype(np.uint16))
    model.write_text(folder / "sparse/0")
    return folder


@pytest.mark.parametrize("place", ["sparse/0", "sparse", "colmap/sparse/0", "."])
def test_images_poses_and_intrinsics(desk, model, check_capture, place):
    if place != "sparse/0":
        (desk / "sparse/0/cameras.txt").unlink()
        model.write_text(desk / place)
    recording = open_recording(desk)
    check_capture(recording, dataset="colmap", notes=(SCALE,))
    np.testing.assert_allclose(recording.timestamps, np.arange(5) / 30)


def test_binary_models(desk, model, check_capture):
    model.write_binary(desk / "sparse/0")
    (desk / "sparse/0/images.txt").write_text("not read")
    check_capture(open_recording(desk), dataset="colmap", notes=(SCALE,))


def _own_depth(depth: np.ndarray) -> bytes:
    return f"{depth.shape[1]}&{depth.shape[0]}&1&".encode() + depth.astype("<f4").tobytes()


def test_own_depth_of_colmap(desk, capture):
    maps = desk / "stereo/depth_maps"
    maps.mkdir(parents=True)
    for n, frame in enumerate(capture):
        (desk / f"depth/{n}.png").unlink()
        (maps / f"{n}.png.photometric.bin").write_bytes(b"not read")
        (maps / f"{n}.png.geometric.bin").write_bytes(_own_depth(frame.depth))
    recording = open_recording(desk)
    assert recording.notes == (
        "COLMAP's own depth is in units of its reconstruction, which need not be metres.",
    )
    assert np.median(np.abs(recording[2].depth[::2, ::2] - capture[2].depth)) < 0.02
    for data, words in (
        (b"", "is no depth map"),
        (b"40&x&1&", "is no depth map"),
        (_own_depth(capture[2].depth)[:-1], "damaged"),
        (b"40000000&40000000&1&", "damaged"),
        (b"-4&-1&1&" + bytes(16), "damaged"),
    ):
        (maps / "2.png.geometric.bin").write_bytes(data)
        with pytest.raises(FrameError, match=words):
            recording[2]


def test_images_without_depth_or_pose(desk, model):
    model.images = [image for image in model.images if image[2] != "1.png"]
    model.write_text(desk / "sparse/0")
    (desk / "depth/3.png").unlink()
    recording = open_recording(desk)
    assert len(recording) == 4
    assert recording.ground_truth.timestamps.shape == (3,)
    assert recording.notes == (
        "1 of 5 images have no depth map and are left out.",
        SCALE,
        "1 of 4 frames have no ground-truth pose.",
    )


@pytest.mark.parametrize(
    ("number", "name", "lens"),
    [(2, "SIMPLE_RADIAL", [0.2]), (3, "RADIAL", [0.2, 0.0]), (4, "OPENCV", [0.2, 0.0, 0.0, 0.0])],
)
def test_lenses_are_taken_out(desk, model, number, name, lens):
    fx, fy, cx, cy = model.parameters
    model.model = (number, name)
    model.parameters = [fx, *([fy] if name == "OPENCV" else []), cx, cy, *lens]
    model.write_binary(desk / "sparse/0")
    recording = open_recording(desk)
    assert float(recording.camera.fy) == pytest.approx(fx)
    assert float(recording.camera.cx) == pytest.approx(cx - 0.5)
    assert recording[0].depth[0, 0] == 0
    assert recording[0].depth[30, 40] > 0


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("cameras.txt", "7 OPENCV_FISHEYE 80 60 1 2 3 4 5 6 7 8", "model OPENCV_FISHEYE can't be read"),
        ("cameras.txt", "7 PINHOLE 80 60 inf 60 40 30", "should be finite numbers"),
        ("cameras.txt", "7 PINHOLE 80 60 1 2 3", "PINHOLE has 4 parameters"),
        ("cameras.txt", "7 PINHOLE 80", "line 1: expected 'id model"),
        ("cameras.txt", "", "has none of the images"),
        ("cameras.txt", "7 PINHOLE 640 480 500 500 320 240", "are for 640x480 images"),
        ("images.txt", "1 1 0 0 0 0 0 7 0.png", "line 1: expected 'id qw"),
        ("images.txt", "", "has none of the images"),
    ],
)
def test_text_models_that_cannot_be_used(desk, name, text, message):
    (desk / "sparse/0" / name).write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        open_recording(desk)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin"])
@pytest.mark.parametrize(
    "change", [lambda data: data[:-9], lambda data: b"\xff" * 8 + data[8:], lambda _: b""]
)
def test_damaged_binary_models(desk, model, name, change):
    model.write_binary(desk / "sparse/0")
    path = desk / "sparse/0" / name
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(InputError, match=rf"{name} is damaged|{name}: cameras of the model number"):
        open_recording(desk)


def test_a_reconstruction_without_depth(desk):
    for path in (desk / "depth").iterdir():
        path.unlink()
    with pytest.raises(InputError, match="has a depth map: put it under the image's name"):
        open_recording(desk)
