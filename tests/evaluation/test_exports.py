"""Runs for other programs, read back by those programs' own packages, and by our readers."""

import json
import sys

import cv2
import numpy as np
import pycolmap
import pytest
import rerun as rr
import trimesh
from evo.tools import file_interface

from sfgs_jax.arrays import FrameError, InputError
from sfgs_jax.datasets import open_recording
from sfgs_jax.evaluation import posed_frames, write_colmap, write_nerfstudio, write_rerun
from sfgs_jax.geometry import format_kitti, format_tum, read_tum
from sfgs_jax.splatting import coloured_points, load_ply


@pytest.fixture(scope="module")
def run(fabricated):
    """Arguments of the writers, and the poses."""
    folder, recording = fabricated
    posed = posed_frames(folder, recording)
    return recording, posed, load_ply(folder / "map.ply")


def assert_same_recording(found, recording, posed):
    """Poses, camera and images of a recording that was read back."""
    assert len(found) == len(posed.indices)
    np.testing.assert_allclose(found.ground_truth.poses, posed.poses, atol=1e-6)
    np.testing.assert_allclose(found.camera.matrix(), recording.camera.matrix(), rtol=1e-6)
    assert found.camera.shape == recording.camera.shape
    frame, original = found[3], recording[int(posed.indices[3])]
    np.testing.assert_allclose(frame.depth, original.depth, atol=0.0006)
    np.testing.assert_allclose(frame.rgb, original.rgb, atol=0.6 / 255)


def test_nerfstudio_and_our_reader_find_the_run_again(run, tmp_path):
    recording, posed, gaussians = run
    out = tmp_path / "nerfstudio"
    assert write_nerfstudio(out, *run) == len(posed.indices)
    found = open_recording(out)
    assert found.dataset == "nerfstudio"
    assert_same_recording(found, recording, posed)
    np.testing.assert_allclose(found.timestamps, recording.timestamps[posed.indices], atol=1e-6)
    content = json.loads((out / "transforms.json").read_text())
    # OpenGL's camera looks along -z, with the principal point counted from the corner.
    matrix = np.asarray(content["frames"][0]["transform_matrix"])
    np.testing.assert_allclose(matrix[:3, 2], -posed.poses[0, :3, 2], atol=1e-12)
    assert (content["cx"], content["w"]) == (float(recording.camera.cx) + 0.5, 64)
    angle = 2 * np.arctan(32 / float(recording.camera.fx))
    np.testing.assert_allclose(content["camera_angle_x"], angle)
    points = trimesh.load(out / content["ply_file_path"])
    assert isinstance(points, trimesh.PointCloud)
    np.testing.assert_array_equal(points.vertices, np.asarray(gaussians.means))
    with pytest.raises(InputError, match="not empty; give a new folder"):
        write_nerfstudio(out, *run)


def test_colmap_finds_the_run_again(run, tmp_path):
    recording, posed, gaussians = run
    out = tmp_path / "colmap"
    assert write_colmap(out, *run) == len(posed.indices)
    model = pycolmap.Reconstruction(out / "sparse" / "0")
    (camera,) = model.cameras.values()
    np.testing.assert_allclose(
        camera.params, np.asarray([60.0, 60.0, 32.0, 24.0]), err_msg="principal point from the corner"
    )
    assert (camera.model.name, camera.width, camera.height) == ("PINHOLE", 64, 48)
    assert model.num_images() == len(posed.indices)
    for number, image in model.images.items():
        world_to_camera = np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]])
        np.testing.assert_allclose(np.linalg.inv(world_to_camera), posed.poses[number - 1], atol=1e-9)
        assert (out / "images" / image.name).is_file()
    centres, rgb = coloured_points(gaussians)
    assert model.num_points3D() == len(centres)
    np.testing.assert_allclose(model.points3D[7].xyz, centres[6], rtol=1e-5)
    np.testing.assert_array_equal(model.points3D[7].color, rgb[6])
    # The first camera stands at the world's origin.
    x, y, z = centres[6]
    pixel = np.asarray(model.images[1].project_point(centres[6]))
    np.testing.assert_allclose(pixel, [60 * x / z + 32, 60 * y / z + 24], rtol=1e-4)
    assert_same_recording(open_recording(out), recording, posed)


def test_rerun_finds_the_run_again(run, tmp_path):
    recording, posed, gaussians = run
    out = tmp_path / "run.rrd"
    assert write_rerun(out, *run) == len(posed.indices)
    columns: dict[str, list] = {}
    times: list[float] = []
    for chunk in rr.chunk.RrdReader(out).stream():
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            columns.setdefault(f"{chunk.entity_path}|{name}", []).extend(batch.column(name).to_pylist())
            if str(chunk.entity_path) == "/world/camera" and name == "frame":
                times += [value.total_seconds() for value in batch.column(name).to_pylist()]
    since = recording.timestamps[posed.indices] - recording.timestamps[0]
    np.testing.assert_allclose(np.sort(times), since, atol=1e-6)
    (points,) = columns["/world/map|Points3D:positions"]
    np.testing.assert_array_equal(points, np.asarray(gaussians.means))
    translations = [row[0] for row in columns["/world/camera|Transform3D:translation"]]
    np.testing.assert_allclose(translations, posed.poses[:, :3, 3], atol=1e-6)
    blob = bytes(columns["/world/camera/image|EncodedImage:blob"][2][0])
    image = cv2.imdecode(np.frombuffer(blob, np.uint8), cv2.IMREAD_COLOR)
    expected = np.asarray(recording[int(posed.indices[2])].rgb)[..., ::-1] * 255
    assert image is not None
    assert np.mean(np.abs(image - expected)) < 5


def test_without_rerun_its_format_is_refused(run, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(InputError, match=r"pip install 'sfgs-jax\[rerun\]'"):
        write_rerun(tmp_path / "run.rrd", *run)


def test_a_frame_that_cannot_be_decoded_is_left_out(run, tmp_path):
    recording, posed, gaussians = run
    broken = type(recording)([FrameError("no"), *recording.frames[1:]], recording.timestamps, None)
    assert write_colmap(tmp_path / "colmap", broken, posed, gaussians) == len(posed.indices) - 1


def test_evo_reads_tum_and_kitti(fabricated, tmp_path):
    trajectory = read_tum(fabricated[0] / "trajectory.txt")
    kitti, tum = tmp_path / "kitti.txt", tmp_path / "tum.txt"
    kitti.write_text(format_kitti(trajectory))
    tum.write_text(format_tum(trajectory))
    poses = file_interface.read_kitti_poses_file(kitti).poses_se3
    np.testing.assert_allclose(poses, trajectory.poses, atol=1e-8)
    found = file_interface.read_tum_trajectory_file(tum)
    np.testing.assert_allclose(found.positions_xyz, trajectory.positions, atol=1e-9)
