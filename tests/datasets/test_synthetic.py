"""Synthetic recordings: exact geometry, and images that a tracker and a mapper can use."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import SyntheticRecording
from sfgs_jax.datasets.synthetic import ROOM_SIZE, add_noise, closed_path, cosine_of_periods, render_view
from sfgs_jax.geometry import Camera, se3


def _steps(poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Metres and degrees between neighbouring poses."""
    relative = np.linalg.inv(poses[:-1]) @ poses[1:]
    cosine = (np.trace(relative[:, :3, :3], axis1=1, axis2=2) - 1) / 2
    return np.linalg.norm(relative[:, :3, 3], axis=1), np.rad2deg(np.arccos(np.clip(cosine, -1, 1)))


@pytest.mark.parametrize("num_frames", [120, 60, 30, 100, 300])
def test_path_is_a_smooth_loop_at_a_hand_held_pace(num_frames):
    poses = closed_path(num_frames)
    np.testing.assert_allclose(poses[-1], poses[0], atol=1e-12)
    rotations = poses[:, :3, :3]
    np.testing.assert_allclose(
        rotations @ rotations.swapaxes(1, 2), np.tile(np.eye(3), (num_frames, 1, 1)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(rotations), 1)
    metres, degrees = _steps(poses)
    assert metres.max() < 0.04
    assert degrees.max() < 4.2
    assert 0.01 < metres.mean() < 0.035
    assert 1.4 < degrees.mean() < 3.5
    # Smooth: the step changes little from one frame to the next.
    assert np.abs(np.diff(metres)).max() < 0.008
    assert np.abs(np.diff(degrees)).max() < 0.9


def test_path_of_one_frame():
    assert closed_path(1).shape == (1, 4, 4)


def test_long_path_sees_all_around_and_stays_in_the_free_middle():
    poses = closed_path(120)
    assert np.abs(poses[:, :2, 3]).max() < 0.8
    directions = np.sort(np.arctan2(poses[:, 1, 2], poses[:, 0, 2]))
    assert np.diff(directions).max() < np.deg2rad(10)
    # Upright: the image's down is the room's down.
    assert poses[:, 2, 1].max() < -0.9


def test_frames_are_the_same_in_any_order_and_differ_by_seed(room):
    first = room[3]
    room[1]
    again = SyntheticRecording(num_frames=5, width=80, height=60)[3]
    np.testing.assert_array_equal(first.rgb, again.rgb)
    np.testing.assert_array_equal(first.depth, again.depth)
    other = SyntheticRecording(num_frames=5, width=80, height=60, seed=1)[3]
    assert np.abs(np.asarray(other.rgb) - first.rgb).mean() > 0.02
    assert room[-1].timestamp == room.timestamps[-1]
    with pytest.raises(IndexError):
        room[5]


def test_depth_is_that_of_the_nearest_triangle(room):
    """Against Möller and Trumbore as they wrote it, every ray with every triangle, in float64."""
    for index in (0, 2):
        camera, pose = room.camera, room.ground_truth.poses[index]
        pixels = np.asarray(camera.pixels(), np.float64)[::3, ::3].reshape(-1, 2)
        fx, fy, cx, cy = (float(x) for x in (camera.fx, camera.fy, camera.cx, camera.cy))
        directions = np.stack(
            [(pixels[:, 0] - cx) / fx, (pixels[:, 1] - cy) / fy, np.ones(len(pixels))], axis=1
        )
        world = directions @ pose[:3, :3].T
        v0, v1, v2 = np.asarray(room.scene.triangles, np.float64).swapaxes(0, 1)
        e1, e2 = v1 - v0, v2 - v0
        p = np.cross(world[:, None], e2)
        det = np.sum(e1 * p, axis=2)
        inverse = 1 / np.where(np.abs(det) > 1e-12, det, np.inf)
        s = pose[:3, 3] - v0
        u = np.sum(s * p, axis=2) * inverse
        q = np.cross(s, e1)
        v = np.sum(world[:, None] * q, axis=2) * inverse
        t = np.sum(e2 * q, axis=1) * inverse
        hit = (det > 1e-12) & (u >= -1e-7) & (v >= -1e-7) & (u + v <= 1 + 1e-7) & (t > 0)
        expected = np.where(hit, t, np.inf).min(axis=1)
        got = np.asarray(room[index].depth)[::3, ::3].ravel()
        # A ray along an edge may fall to either side of it.
        close = np.abs(got - expected) < 1e-4 * expected
        assert close.mean() > 0.995
        assert np.all(got > 0)


def test_room_is_seen_at_indoor_depths(room):
    for i in range(len(room)):
        depth = np.asarray(room[i].depth)
        assert depth.min() > 0.5
        assert depth.max() < np.linalg.norm(ROOM_SIZE)
        assert np.ptp(depth) > 1.0


def _sample(image: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Bilinear samples at pixels (u, v) inside."""
    u0, v0 = np.floor(pixels).astype(int).T
    fu, fv = (pixels - np.floor(pixels)).T
    if image.ndim == 3:
        fu, fv = fu[:, None], fv[:, None]
    top = image[v0, u0] * (1 - fu) + image[v0, u0 + 1] * fu
    bottom = image[v0 + 1, u0] * (1 - fu) + image[v0 + 1, u0 + 1] * fu
    return top * (1 - fv) + bottom * fv


def _reprojection_errors(room, i: int, j: int, T_j_i: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Relative depth errors and colour errors of frame i's points in frame j."""
    a, b, camera = room[i], room[j], room.camera
    points = np.asarray(camera.unproject(camera.pixels(), jnp.asarray(a.depth)), np.float64).reshape(-1, 3)
    moved = points @ T_j_i[:3, :3].T + T_j_i[:3, 3]
    pixels = np.asarray(camera.project(jnp.asarray(moved, jnp.float32)), np.float64)
    inside = np.all((pixels >= 0) & (pixels < np.array([camera.width, camera.height]) - 1.001), axis=1)
    assert inside.mean() > 0.6
    depth = 1 / _sample(1 / np.asarray(b.depth, np.float64), pixels[inside])  # planes are linear in 1/z
    colour = _sample(np.asarray(b.rgb), pixels[inside])
    return (
        np.abs(depth / moved[inside, 2] - 1),
        np.abs(colour - np.asarray(a.rgb).reshape(-1, 3)[inside]).mean(axis=1),
    )


def test_depth_and_colour_agree_with_the_poses(room):
    i, j = 0, 2
    T_world_cam = room.ground_truth.poses
    T_j_i = np.linalg.inv(T_world_cam[j]) @ T_world_cam[i]
    assert np.linalg.norm(T_j_i - np.eye(4)) > 0.02
    depth_error, colour_error = _reprojection_errors(room, i, j, T_j_i)
    # The same surface but for occlusions and edges.
    assert np.median(depth_error) < 1e-5
    assert np.mean(depth_error < 1e-3) > 0.75
    assert np.median(colour_error) < 0.015
    # A wrong pose shows: the test can fail.
    wrong_depth_error, wrong_colour_error = _reprojection_errors(room, i, j, np.eye(4))
    assert np.median(wrong_depth_error) > 100 * np.median(depth_error)
    assert np.median(wrong_colour_error) > 2 * np.median(colour_error)


def test_surfaces_have_texture_everywhere_but_not_at_the_pixel_scale():
    room = SyntheticRecording(num_frames=2, width=80, height=60)
    # At twice the resolution the same picture appears, so little is lost between pixels.
    grey = np.asarray(room[0].rgb).mean(axis=2)
    blocks = grey[:60, :80].reshape(4, 15, 5, 16).std(axis=(1, 3))
    assert np.mean(blocks > 0.015) > 0.9
    neighbours = np.abs(np.diff(grey, axis=1))
    assert np.median(neighbours) < 0.05


def test_waves_are_cosines_of_periods():
    periods = jnp.linspace(-3, 3, 1001)
    np.testing.assert_allclose(
        cosine_of_periods(periods), np.cos(2 * np.pi * np.asarray(periods, np.float64)), atol=3e-4
    )


def test_noise_is_a_kinects(key):
    room = SyntheticRecording(num_frames=5, width=80, height=60)
    camera = room.camera
    view = render_view(room.scene, camera, se3.from_matrix(room.ground_truth.poses[0]))
    samples = [add_noise(k, view, camera) for k in jax.random.split(key, 40)]
    rgb = np.stack([np.asarray(rgb) for rgb, _ in samples])
    depth = np.stack([np.asarray(depth) for _, depth in samples])
    z = np.asarray(view.depth)
    holes = depth == 0
    assert 0.002 < holes.mean() < 0.2
    # Edges lose more than flat parts.
    jump = np.abs(np.diff(z, axis=1, append=z[:, -1:])) > 0.2
    assert holes[:, jump].mean() > 5 * holes[:, ~jump].mean()
    smooth = holes.mean(axis=0) < 0.05
    error = np.where(holes, np.nan, depth - z)[:, smooth]
    # Nguyen's sigma and the disparity's uniform step add up.
    sigma = 0.0012 + 0.0019 * (z[smooth] - 0.4) ** 2
    step = z[smooth] ** 2 / (0.82 * 640 * 0.075) * 0.125
    expected = np.sqrt(sigma**2 + step**2 / 12)
    ratio = np.nanstd(error, axis=0) / expected
    assert 0.85 < np.median(ratio) < 1.15
    assert abs(np.nanmean(error / expected)) < 0.1
    assert np.std(rgb - np.asarray(view.rgb)) == pytest.approx(0.008, rel=0.1)


def test_noisy_frames_are_deterministic():
    noisy = SyntheticRecording(num_frames=5, width=80, height=60, noise=True)
    np.testing.assert_array_equal(noisy[2].depth, noisy[2].depth)
    assert np.any(np.asarray(noisy[2].depth) != np.asarray(noisy[3].depth))


def test_camera_is_an_ordinary_one(room):
    assert isinstance(room.camera, Camera)
    assert float(room.camera.fx) == pytest.approx(0.82 * 80)
    assert (float(room.camera.cx), float(room.camera.cy)) == (39.5, 29.5)


def test_ring_comes_back_to_where_it_began_at_a_walking_pace():
    poses = SyntheticRecording(num_frames=1000, width=80, height=60, place="ring").ground_truth.poses
    metres, degrees = _steps(poses)
    assert 30 < metres.sum() < 36
    assert metres.max() < 0.05
    assert degrees.max() < 5
    late = poses[-80:]
    nearest = np.linalg.norm(late[:, :2, 3] - poses[0, :2, 3], axis=1).argmin()
    assert 0 < nearest < 79
    assert late[nearest, :3, 2] @ poses[0, :3, 2] > 0.8


def test_twin_rooms_look_the_same_from_corresponding_places():
    twins = SyntheticRecording(num_frames=120, width=80, height=60, place="twins")
    T = twins.ground_truth.poses[10].copy()
    images = []
    for x in (-6.0, 6.0):
        T[:2, 3] = x, -0.4
        images.append(render_view(twins.scene, twins.camera, se3.from_matrix(T)))
    np.testing.assert_allclose(images[0].depth, images[1].depth, rtol=1e-4, atol=1e-4)
    # But for the lamps, whose light hardly reaches either.
    assert np.abs(np.asarray(images[0].rgb) - np.asarray(images[1].rgb)).mean() < 0.02


def test_at_the_desk_everything_is_close_and_the_camera_keeps_its_pace():
    desk = SyntheticRecording(num_frames=420, width=80, height=60, place="desk")
    metres, degrees = _steps(desk.ground_truth.poses)
    assert metres.max() < 0.025
    assert degrees.max() < 3
    for index in range(0, 420, 60):
        depth = np.asarray(desk[index].depth)
        assert 0.2 < np.median(depth[depth > 0]) < 0.9
        assert np.mean(depth > 0) > 0.6


@pytest.mark.parametrize("place", ["wall", "sphere"])
def test_bare_places_have_no_texture_when_seen_alone(place):
    recording = SyntheticRecording(num_frames=60, width=80, height=60, place=place)
    grey = np.asarray(recording[30].rgb).mean(axis=2)[15:45, 20:60]
    assert np.abs(np.diff(grey, axis=1)).max() < 0.03
    assert np.ptp(np.asarray(recording[0].rgb).mean(axis=2)) > 0.3


@pytest.fixture(scope="module")
def building():
    return SyntheticRecording(num_frames=10_000, width=64, height=48, place="building")


def test_the_walk_leads_through_thirty_rooms_and_back_to_the_first(building):
    positions = building.ground_truth.positions
    metres, degrees = _steps(building.ground_truth.poses)
    assert metres.max() < 0.05
    assert degrees.max() < 8
    rooms = np.rint(positions[:, :2] / 7).astype(int)
    assert len(np.unique(rooms, axis=0)) == 30
    first = np.all(rooms == 0, axis=1)
    away = np.flatnonzero(np.diff(first.astype(int)))
    assert first[0]
    assert first[-1]
    assert away[1] - away[0] > 8000


def test_a_frame_shows_what_the_whole_building_would(building):
    for index in (0, 2500, 9300):
        whole = render_view(
            building.scene, building.camera, se3.from_matrix(building.ground_truth.poses[index])
        )
        seen = building[index].depth > 0
        # Beyond the next room it is dark.
        assert seen.mean() > 0.9
        np.testing.assert_allclose(building[index].depth[seen], np.asarray(whole.depth)[seen], rtol=1e-5)


def test_unknown_place_is_named():
    with pytest.raises(InputError, match="cellar"):
        SyntheticRecording.parse("synthetic:place=cellar")
