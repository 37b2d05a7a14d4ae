"""The folder of a run whose recording is there: images, intrinsics, uncertainty, stills, videos."""

import json

import cv2
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.datasets import open_recording
from sfgs_jax.geometry import Trajectory, format_covariances, format_tum
from sfgs_jax.splatting import Gaussians, rgb_to_sh, save_ply
from sfgs_jax.viewer import view_run

SOURCE = "synthetic:frames=4,width=80,height=60"


def _gaussians_of(recording) -> Gaussians:
    """A small opaque Gaussian for every pixel of the first frame."""
    frame, camera = recording[0], recording.camera
    depth = jnp.asarray(frame.depth).reshape(-1)
    points = camera.unproject(camera.pixels().reshape(-1, 2), depth)
    size = jnp.log(0.6 * depth / camera.fx)
    return Gaussians(
        means=points,
        quaternions=jnp.tile(jnp.asarray([1.0, 0, 0, 0]), (len(depth), 1)),
        log_scales=jnp.tile(size[:, None], (1, 3)),
        opacity_logits=jnp.full(len(depth), 4.0),
        sh=rgb_to_sh(jnp.asarray(frame.rgb).reshape(-1, 3))[:, None],
        valid=depth > 0,
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "room"
    folder.mkdir()
    recording = open_recording(SOURCE)
    poses = np.linalg.inv(recording.ground_truth.poses[0]) @ recording.ground_truth.poses
    # The time stamps are a tenth of a second apart from a slow camera, and one frame was lost.
    trajectory = Trajectory(recording.timestamps, poses)[np.array([0, 1, 3])]
    covariances = np.tile(np.diag([1e-4, 4e-4, 9e-4, 1e-6, 1e-6, 1e-6]), (3, 1, 1))
    save_ply(folder / "map.ply", _gaussians_of(recording))
    (folder / "trajectory.txt").write_text(format_tum(trajectory))
    (folder / "keyframes.txt").write_text(format_tum(trajectory[::2]))
    (folder / "trajectory_covariance.txt").write_text(format_covariances(trajectory.timestamps, covariances))
    (folder / "config.json").write_text(
        json.dumps({"source": SOURCE, "dataset": "synthetic", "reader": {"stride": 1, "unknown": 1}})
    )
    return folder


@pytest.fixture(scope="module")
def scene(folder):
    scene = view_run(folder, port=0, block=False)
    yield scene
    scene.close()


@pytest.fixture
def recording():
    return open_recording(SOURCE)


def _picture(path) -> np.ndarray:
    return cv2.imread(str(path))[..., ::-1].astype(np.float32) / 255


def test_frusta_have_the_field_of_view_of_the_recording(scene, recording):
    camera = recording.camera
    expected = 2 * np.arctan(camera.height / 2 / float(camera.fy))
    for frustum in (*scene.frusta, scene.replay):
        np.testing.assert_allclose(frustum.fov, expected, rtol=1e-6)
        np.testing.assert_allclose(frustum.aspect, 80 / 60, rtol=1e-6)


def test_the_recorded_image_is_beside_the_rendered_one(scene, recording):
    scene.show_frame(0)
    recorded, rendered = scene.pictures()
    np.testing.assert_allclose(recorded / 255, recording[0].rgb, atol=0.01)
    error = np.abs(rendered.astype(float) - recorded).mean() / 255
    assert error < 0.05
    scene.show_frame(2)
    recorded, rendered = scene.pictures()
    # The third pose is of the recording's fourth frame.
    np.testing.assert_allclose(recorded / 255, recording[3].rgb, atol=0.01)


def test_depth_is_shown_beside_depth(scene):
    scene.show_frame(0)
    scene.show_map(mode="depth")
    recorded, rendered = scene.pictures()
    assert np.median(np.abs(recorded.astype(int) - rendered).max(axis=2)) < 12
    scene.show_map()


def test_ellipsoids_have_three_standard_deviations(scene):
    """The deviations 1, 2 and 3 cm, drawn at the enlargement that the page begins with."""
    ellipsoids = scene.server.scene.get_handle_by_name("/trajectory/uncertainty")
    scales = np.sort(ellipsoids.batched_scales, axis=1)
    np.testing.assert_allclose(scales / scales[:, :1], np.tile([[1.0, 2.0, 3.0]], (3, 1)), rtol=1e-4)
    np.testing.assert_allclose(scales[:, 2] / 0.09, np.round(scales[:, 2] / 0.09), rtol=1e-4)


def test_stills_show_the_map_as_it_is_shown(scene, recording, tmp_path):
    scene.show_frame(0)
    scene.show_map()
    scene.save_still(tmp_path / "still.png", width=80, height=60)
    assert np.abs(_picture(tmp_path / "still.png") - recording[0].rgb).mean() < 0.05
    behind = np.diag([-1.0, 1, -1, 1])
    scene.save_still(tmp_path / "behind.png", width=80, height=60, T_world_cam=behind)
    assert _picture(tmp_path / "behind.png").max() == 0
    scene.show_map(mode="depth")
    scene.save_still(tmp_path / "depth.png", width=80, height=60)
    depth = _picture(tmp_path / "depth.png")
    far = np.unravel_index(np.argmax(recording[0].depth), (60, 80))
    near = np.unravel_index(np.argmin(recording[0].depth), (60, 80))
    assert depth[far][2] > depth[far][0]
    assert depth[near][0] > depth[near][2]
    scene.show_map()
    with pytest.raises(Exception, match="16 to 4096"):
        scene.save_still(tmp_path / "large.png", width=5000, height=60)


def test_a_video_takes_the_time_of_the_recording(scene, recording, tmp_path):
    shares = []
    done = scene.save_video(
        tmp_path / "a.mp4", width=81, height=60, speed=0.5, progress=lambda share: not shares.append(share)
    )
    assert done
    video = cv2.VideoCapture(str(tmp_path / "a.mp4"))
    duration = recording.timestamps[3] - recording.timestamps[0]
    frames = video.get(cv2.CAP_PROP_FRAME_COUNT)
    assert frames == len(shares) == int(2 * duration * 30 + 1e-6) + 1
    image = video.read()[1][..., ::-1] / 255
    assert image.shape == (60, 80, 3)
    assert np.abs(image - recording[0].rgb).mean() < 0.07
    assert not scene.save_video(tmp_path / "b.mp4", width=80, height=60, progress=lambda _: False)
    assert not (tmp_path / "b.mp4").exists()


@pytest.mark.parametrize("config", [None, {"source": "/there/is/no/recording", "dataset": "tum"}])
def test_without_the_recording_the_rest_is_shown(folder, tmp_path, config, capsys):
    for name in ("map.ply", "trajectory.txt", "keyframes.txt"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    if config is not None:
        (tmp_path / "config.json").write_text(json.dumps(config))
        camera = {"fx": 40, "fy": 40, "cx": 31.5, "cy": 23.5, "width": 64, "height": 48}
        (tmp_path / "metrics.json").write_text(json.dumps({"camera": camera}))
    scene = view_run(tmp_path, port=0, block=False)
    try:
        assert "The recorded images are not there." in capsys.readouterr().out
        assert len(scene.frusta) == 2
        np.testing.assert_allclose(
            scene.frusta[0].fov, np.radians(48) if config is None else 2 * np.arctan(24 / 40), rtol=1e-6
        )
    finally:
        scene.close()
