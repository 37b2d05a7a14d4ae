"""Up by the planes of a map."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sfgs_jax.viewer import Splats, find_level

AXES = np.eye(3)


def discs(rng, normal, count: int, corner, across: tuple) -> tuple[np.ndarray, np.ndarray]:
    """Centres on a plane, and the covariances of rough flat Gaussians on it."""
    a, b = across
    centres = np.asarray(corner) + rng.uniform(0, 3, (count, 1)) * a + rng.uniform(0, 3, (count, 1)) * b
    rough = Rotation.from_rotvec(rng.normal(scale=np.radians(6), size=(count, 3))).as_matrix()
    axes = rough @ np.stack([normal, a, b], axis=1)
    return centres, axes @ np.diag(np.square([0.005, 0.02, 0.03])) @ axes.transpose(0, 2, 1)


def map_of(planes: list[tuple[np.ndarray, np.ndarray]], turned: Rotation) -> Splats:
    centres, covariances = (np.concatenate(parts) for parts in zip(*planes, strict=True))
    matrix = turned.as_matrix()
    return Splats(
        (centres @ matrix.T).astype(np.float32),
        (matrix @ covariances @ matrix.T).astype(np.float32),
        np.full((len(centres), 3), 0.5, np.float32),
        np.full((len(centres), 1), 0.9, np.float32),
    )


@pytest.fixture
def room(rng):
    """A floor at a height of 0 and two walls; y points down."""
    x, y, z = AXES
    return [
        discs(rng, y, 500, (0, 0, 0), (x, z)),
        discs(rng, z, 400, (0, -3, 3), (x, y)),
        discs(rng, x, 300, (0, -3, 0), (y, z)),
    ]


@pytest.mark.parametrize("turn", [(0, 0, 0), (35, 0, 0), (-20, 60, 25), (0, 0, -40)])
def test_up_is_that_of_the_floor_and_the_walls(room, turn):
    turned = Rotation.from_euler("xyz", turn, degrees=True)
    level = find_level(map_of(room, turned), np.zeros((0, 4, 4)))
    up = turned.apply([0, -1, 0])
    assert np.degrees(np.arccos(np.clip(level.up @ up, -1, 1))) < 1.5
    assert abs(level.floor) < 0.1
    assert level.share > 0.9


def test_the_cameras_tell_which_way_is_up(room):
    """A map that is upside down in its own axes: no search from -y finds its up, the cameras' does."""
    turned = Rotation.from_euler("z", 170, degrees=True)
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, :3] = turned.as_matrix()
    up = turned.apply([0, -1, 0])
    assert find_level(map_of(room, turned), poses).up @ up > 0.999
    assert find_level(map_of(room, turned), poses[:0]).up @ up < -0.99


def test_planes_that_do_not_tell_up_give_none(room, rng):
    assert find_level(map_of(room[1:2], Rotation.identity()), np.zeros((0, 4, 4))) is None
    x, y, z = AXES
    centres, covariances = discs(rng, y, 1000, (0, 0, 0), (x, z))
    spun = Rotation.from_quat(rng.normal(size=(1000, 4))).as_matrix()
    ball = [(centres, spun @ covariances @ spun.transpose(0, 2, 1))]
    assert find_level(map_of(ball, Rotation.identity()), np.zeros((0, 4, 4))) is None
    few = [(centres[:50], covariances[:50]) for centres, covariances in room]
    assert find_level(map_of(few[:1], Rotation.identity()), np.zeros((0, 4, 4))) is None
    nothing = (np.zeros((0, 3)), np.zeros((0, 3, 3)))
    assert find_level(map_of([nothing], Rotation.identity()), np.zeros((0, 4, 4))) is None
