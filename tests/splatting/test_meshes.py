"""Fusion of depth images to a mesh: where the surface lies, its colours, its memory, its files."""

import numpy as np
import pytest
import trimesh
from trimesh.visual import ColorVisuals

from sfgs_jax.arrays import InputError
from sfgs_jax.geometry import Camera, orbit
from sfgs_jax.splatting.mesh import (
    Mesh,
    TsdfVolume,
    load_mesh,
    save_mesh,
    without_small_parts,
    zero_surface,
)

CAMERA = Camera(80.0, 80.0, 39.5, 29.5, width=80, height=60)
U, V = np.meshgrid(np.arange(80.0), np.arange(60.0))
RAYS = np.stack([(U - 39.5) / 80, (V - 29.5) / 80, np.ones_like(U)], axis=-1)
VOXEL = 0.04
CENTRE, RADIUS = np.asarray([0.3, -0.2, 0.5]), 0.5


def ball_depth(pose: np.ndarray) -> np.ndarray:
    """Depth of the ball along z, 0 beside it."""
    centre = pose[:3, :3].T @ (CENTRE - pose[:3, 3])
    a, b = np.sum(RAYS**2, axis=-1), RAYS @ centre
    discriminant = b**2 - a * (centre @ centre - RADIUS**2)
    return np.where(discriminant > 0, (b - np.sqrt(np.maximum(discriminant, 0))) / a, 0)


def ball_colours(pose: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Red grows along x of the world, and green along y."""
    points = (RAYS * depth[..., None]) @ pose[:3, :3].T + pose[:3, 3]
    rgb = 0.5 + 0.8 * (points - CENTRE)
    rgb[..., 2] = 0.25
    return np.where(depth[..., None] > 0, rgb, 0)


def fused_ball(**settings) -> TsdfVolume:
    volume = TsdfVolume(VOXEL, **settings)
    up = np.asarray([0.0, -1, 0])
    for elevation in (-0.9, 0.0, 0.9):
        for pose in orbit(CENTRE, up, radius=1.6, elevation=elevation, num_poses=6):
            depth = ball_depth(pose)
            volume.integrate(depth, ball_colours(pose, depth), CAMERA, pose)
    return volume


@pytest.fixture(scope="module")
def ball() -> tuple[TsdfVolume, Mesh]:
    volume = fused_ball()
    return volume, zero_surface(volume)


def test_a_ball_seen_from_around_is_a_closed_surface_in_its_place(ball):
    _, mesh = ball
    distances = np.linalg.norm(mesh.vertices - CENTRE, axis=1) - RADIUS
    assert np.max(np.abs(distances)) < 0.3 * VOXEL
    assert np.sqrt(np.mean(distances**2)) < 0.1 * VOXEL
    surface = trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)
    # Bricks join without a crack, and the front is outside.
    assert surface.is_watertight
    assert surface.volume == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.02)


def test_the_colours_are_those_of_the_images(ball):
    _, mesh = ball
    expected = 0.5 + 0.8 * (mesh.vertices - CENTRE)
    expected[:, 2] = 0.25
    assert np.sqrt(np.mean((mesh.rgb - expected) ** 2)) < 0.02


def test_a_slanted_plane_has_no_stairs():
    # The plane n . x = 1.2, seen by one image. The pixels are as large as the voxels.
    normal = np.asarray([0.6, 0.0, 0.8])
    volume = TsdfVolume(VOXEL)
    volume.integrate(1.2 / (RAYS @ normal), np.ones((60, 80, 3)), CAMERA, np.eye(4))
    mesh = zero_surface(volume)
    assert len(mesh.triangles) > 1000
    off = np.abs(mesh.vertices @ normal - 1.2)
    assert np.percentile(off, 95) < 0.002 * VOXEL
    # The outermost voxels see the nearest pixel of the image's border.
    assert np.max(off) < 0.2 * VOXEL
    np.testing.assert_allclose(mesh.rgb, 1, atol=1e-6)


def test_memory_is_bounded_and_bricks_without_room_are_counted(ball):
    whole, _ = ball
    assert whole.num_dropped == 0
    assert whole.num_bytes == len(whole.bricks) * 98_304
    small = fused_ball(max_bytes=5 * 98_304 + 1)
    assert (len(small.bricks), small.num_bytes) == (5, 5 * 98_304)
    assert small.num_dropped == len(whole.bricks) - 5
    assert len(zero_surface(small).triangles) > 0


def test_missing_depth_and_little_weight_leave_no_surface():
    volume = TsdfVolume(VOXEL)
    nothing = np.full((60, 80), np.nan)
    volume.integrate(nothing, np.zeros((60, 80, 3)), CAMERA, np.eye(4))
    assert not volume.bricks
    volume.integrate(np.full((60, 80), 1.0), np.zeros((60, 80, 3)), CAMERA, np.eye(4))
    assert len(zero_surface(volume).triangles) > 0
    assert len(zero_surface(volume, least_weight=1.5).triangles) == 0


def test_small_parts_are_left_out(ball):
    _, mesh = ball
    speck = Mesh(
        np.concatenate([mesh.vertices, np.eye(3)]),
        np.concatenate([mesh.triangles, len(mesh.vertices) + np.asarray([[0, 1, 2]])]),
        np.concatenate([mesh.rgb, np.eye(3)]),
    )
    kept = without_small_parts(speck, 2)
    np.testing.assert_array_equal(kept.vertices, mesh.vertices)
    np.testing.assert_array_equal(kept.triangles, mesh.triangles)
    assert len(without_small_parts(mesh, len(mesh.triangles) + 1).triangles) == 0


def test_files_hold_the_mesh_in_their_axes(ball, tmp_path):
    _, mesh = ball
    for name, axes in (("ball.ply", [1, 1, 1]), ("ball.glb", [1, -1, -1])):
        save_mesh(tmp_path / name, mesh)
        found = trimesh.load_mesh(tmp_path / name, process=False)
        found = found.to_mesh() if isinstance(found, trimesh.Scene) else found
        np.testing.assert_allclose(found.vertices, mesh.vertices * axes, atol=1e-6)
        np.testing.assert_array_equal(found.faces, mesh.triangles)
        assert isinstance(found.visual, ColorVisuals)
        levels = np.asarray(found.visual.vertex_colors)[:, :3] / 255
        # Light of 0.25 in sRGB is 0.0509.
        assert np.median(levels[:, 2]) == pytest.approx(0.25 if name.endswith("ply") else 0.0509, abs=0.004)


def test_bad_input_gets_one_sentence(ball, tmp_path):
    _, mesh = ball
    with pytest.raises(InputError, match=r"as \.ply or \.glb, not as \.obj"):
        save_mesh(tmp_path / "ball.obj", mesh)
    with pytest.raises(InputError, match="no triangle"):
        save_mesh(tmp_path / "none.ply", Mesh(np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros((0, 3))))
    with pytest.raises(InputError, match=r"above 0 m, not 0\.0"):
        TsdfVolume(0.0)
    with pytest.raises(InputError, match="more than max_bytes, 10"):
        TsdfVolume(0.1, max_bytes=10)
    with pytest.raises(InputError, match=r"don't fit a camera of \(60, 80\)"):
        TsdfVolume(0.1).integrate(np.ones((3, 4)), np.ones((3, 4, 3)), CAMERA, np.eye(4))
    assert not list(tmp_path.iterdir())


def test_a_mesh_in_the_plane_is_refused(ball, tmp_path):
    _, mesh = ball
    path = tmp_path / "ball.glb"
    save_mesh(path, mesh)
    path.write_bytes(path.read_bytes().replace(b'"VEC3"', b'"VEC2"'))
    with pytest.raises(InputError, match="corners of 2 coordinates"):
        load_mesh(path)
