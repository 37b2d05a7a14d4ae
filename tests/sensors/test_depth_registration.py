"""Registration of depth to colour by what the camera's own registration leaves out."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from sfgs_jax.datasets import KinectFaults, SyntheticRecording
from sfgs_jax.geometry import Camera, se3
from sfgs_jax.sensors import DEPTH_GRID, DepthCorrection, depth_slopes

CAMERA = Camera(130.0, 130.0, 79.5, 59.5, width=160, height=120)
TANGENT = np.asarray([0.02, -0.01, 0.015, 0.01, -0.006, 0.012])
corrected = jax.jit(DepthCorrection.corrected)


def by(tangent):
    return DepthCorrection(jnp.zeros(DEPTH_GRID), jnp.asarray(tangent, jnp.float32))


def plane(normal, distance, T):
    """Depth of a plane n p = -d of the colour camera's frame, seen by a camera with T_colour_cam."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    rays = np.stack([(u - 79.5) / 130, (v - 59.5) / 130, np.ones(CAMERA.shape)], axis=-1)
    turned = T[:3, :3].T @ normal
    return -(distance + normal @ T[:3, 3]) / (rays @ turned)


@pytest.mark.parametrize("normal", [(0.0, 0.0, -1.0), (0.5, 0.2, -0.85)])
def test_a_plane_is_where_the_colour_camera_sees_it(normal):
    normal = np.asarray(normal) / np.linalg.norm(normal)
    beside, wanted = (plane(normal, 2.0, T) for T in (se3.exps_of(TANGENT[None])[0], np.eye(4)))
    found = np.asarray(corrected(by(TANGENT), jnp.asarray(beside, jnp.float32), CAMERA))
    known = found > 0
    assert known.mean() > 0.93
    assert np.abs(beside - wanted)[known].mean() > 0.01
    # The flow is taken where the ray ends, which is right to a twentieth of the change.
    np.testing.assert_allclose(found[known], wanted[known], rtol=5e-4)


def test_a_room_is_where_the_colour_camera_sees_it():
    faults = KinectFaults(extrinsic_shift=0.01, extrinsic_turn=0.005)
    beside, room = (
        SyntheticRecording(num_frames=2, width=160, height=120, faults=each) for each in (faults, None)
    )
    tangent = se3.logs_of(beside.T_colour_depth[None])[0]
    found = np.asarray(corrected(by(tangent), jnp.asarray(beside[1].depth), room.camera))
    known, truth = found > 0, np.asarray(room[1].depth)
    assert known.mean() > 0.98
    off, before = (np.abs(np.asarray(x) - truth)[known] for x in (found, beside[1].depth))
    assert np.percentile(off, 90) < 0.02 * np.percentile(before, 90)


def test_missing_depth_stays_missing_and_its_gradient_is_finite():
    depth = np.full(CAMERA.shape, 2.0, np.float32)
    depth[40:80, 60:100], depth[10, 10] = 0, np.nan
    depth = jnp.asarray(depth)

    @jax.jit
    def total(tangent):
        return jnp.sum(DepthCorrection(jnp.zeros(DEPTH_GRID), tangent).corrected(depth, CAMERA))

    tangent = jnp.asarray(TANGENT, jnp.float32)
    found = np.asarray(corrected(by(TANGENT), depth, CAMERA))
    assert np.isfinite(found).all()
    assert (found[45:75, 65:95] == 0).all()
    assert np.isfinite(jax.grad(total)(tangent)).all()


def test_gradients_reach_the_extrinsic(float64):
    depth = jnp.asarray(plane(np.asarray([0.3, 0.1, -0.95]), 2.0, np.eye(4)))
    camera = Camera(*(jnp.asarray(x, jnp.float64) for x in (130, 130, 79.5, 59.5)), width=160, height=120)

    def middle(tangent):
        moved = DepthCorrection(jnp.zeros(DEPTH_GRID, jnp.float64), tangent).corrected(depth, camera)
        return moved[40:80:8, 50:110:8]

    check_grads(jax.jit(middle), (jnp.asarray(TANGENT),), order=1, modes=["rev"], eps=1e-6)


def test_slopes_say_how_depth_changes_along_a_ray(rng):
    normal = np.asarray([0.3, 0.1, -0.95]) / np.linalg.norm([0.3, 0.1, -0.95])
    here = plane(normal, 2.0, np.eye(4))
    points = np.asarray(CAMERA.unproject(CAMERA.pixels(), jnp.asarray(here, jnp.float32)))[30::20, 30::20]
    points = points.reshape(-1, 3).T
    normals = np.broadcast_to(normal[:, None], points.shape)
    slopes = np.asarray(jax.jit(depth_slopes)(jnp.asarray(points), jnp.asarray(normals, jnp.float32)))
    for axis, step in enumerate(1e-3 * np.eye(6)):
        # The surface moves with the depth camera: that of the moved plane along the same rays.
        T = np.linalg.inv(se3.exps_of(step[None])[0])
        moved = plane(normal, 2.0, T)[30::20, 30::20].ravel()
        np.testing.assert_allclose(moved / points[2] - 1, 1e-3 * slopes[axis], atol=4e-6)
    unknown = jax.jit(depth_slopes)(jnp.asarray(points), jnp.zeros(points.shape, jnp.float32))
    assert np.isfinite(unknown).all()
