"""ICL-NUIM's left-handed cameras become ordinary ones."""

import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import open_recording
from sfgs_jax.geometry import Trajectory, format_tum, se3


@pytest.fixture
def living_room(tmp_path, write_image, images):
    """Frames 0 to 2, with published poses of frames 1 and 2, as the archives have them."""
    folder = tmp_path / "living_room_traj0_frei_png"
    for n in range(3):
        rgb, depth = images(640, 480)
        depth[0, 0] = 5000 * (n + 1)
        write_image(folder / "rgb" / f"{n}.png", rgb)
        write_image(folder / "depth" / f"{n}.png", depth)
    published = [
        np.asarray(se3.matrix(se3.exp(jnp.asarray([0.3 * n, 0.2, -2.0, 0.1, 0.2 * n, -0.3]))), np.float64)
        for n in (1, 2)
    ]
    trajectory = Trajectory(np.array([1.0, 2.0]), np.stack(published))
    (folder / "livingRoom0.gt.freiburg").write_text(format_tum(trajectory))
    (folder / "associations.txt").write_text(
        "".join(f"{n} depth/{n}.png {n} rgb/{n}.png\n" for n in range(3))
    )
    return folder, trajectory.poses


@pytest.mark.parametrize("with_associations", [True, False])
def test_frames_and_times(living_room, with_associations):
    folder, _ = living_room
    if not with_associations:
        (folder / "associations.txt").unlink()
    recording = open_recording(folder)
    assert recording.dataset == "icl_nuim"
    np.testing.assert_allclose(recording.timestamps, np.arange(3) / 30)
    assert float(np.asarray(recording[2].depth)[0, 0]) == pytest.approx(3.0)
    np.testing.assert_allclose(recording.ground_truth.timestamps, np.array([1, 2]) / 30)
    assert recording.notes == ("1 of 3 frames have no ground-truth pose.",)


def test_a_point_has_the_pixel_that_the_published_camera_gives_it(living_room):
    folder, published = living_room
    recording = open_recording(folder)
    assert float(recording.camera.fy) > 0
    for T, ours in zip(published, recording.ground_truth.poses, strict=True):
        assert np.linalg.det(ours[:3, :3]) == pytest.approx(1)
        in_camera = np.array([0.4, -0.3, 2.5])  # the published one: y up
        point = T[:3, :3] @ in_camera + T[:3, 3]
        pixel = [481.2 * 0.4 / 2.5 + 319.5, -480.0 * -0.3 / 2.5 + 239.5]
        # In our world y is negated.
        ours_in_camera = ours[:3, :3].T @ (point * [1, -1, 1] - ours[:3, 3])
        got = recording.camera.project(jnp.asarray(ours_in_camera, jnp.float32))
        np.testing.assert_allclose(got, pixel, atol=1e-3)


def test_broken_association_is_refused(living_room):
    folder, _ = living_room
    (folder / "associations.txt").write_text("0 depth/0.png\n")
    with pytest.raises(InputError, match=r"associations\.txt, line 1"):
        open_recording(folder)
