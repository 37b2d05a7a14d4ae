"""States on disk: what is loaded is what was saved, and old images leave memory."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from sfgs_jax import slam
from sfgs_jax.geometry import InputError
from sfgs_jax.slam.array_file import read_arrays, write_arrays
from sfgs_jax.slam.storage import STATE_FILE, spill


@pytest.fixture
def busy(config):
    """Settings that give keyframes, views and edges within a few frames."""
    return replace(
        config,
        tracking=replace(config.tracking, keyframe_translation=0.03),
        mapping=replace(config.mapping, view_interval=2, views_in_memory=1),
    )


def follow(state, frames):
    for frame in frames:
        state, _ = slam.step(state, frame)
    return state


def assert_equal(a, b):
    left, right = jax.tree.leaves(a), jax.tree.leaves(b)
    assert len(left) == len(right)
    for x, y in zip(left, right, strict=True):
        np.testing.assert_array_equal(x, y)


def test_a_saved_state_goes_on_to_the_same_end(room, frames, busy, tmp_path):
    half = follow(slam.init(room.camera, busy), frames[:6])
    assert len(half.keyframes) > 1
    slam.save(half, tmp_path)
    again = slam.load(tmp_path, busy)
    assert jax.tree.structure(again) == jax.tree.structure(half)
    assert_equal(again, half)
    assert_equal(follow(again, frames[6:9]), follow(half, frames[6:9]))

    spilled = spill(half, tmp_path / "images")
    on_disk = [isinstance(k.observation.keypoints.depth, np.memmap) for k in spilled.keyframes]
    assert on_disk == [True] * (len(on_disk) - 1) + [False]
    assert isinstance(spilled.mapping.views[0].rgb, np.memmap)
    assert_equal(follow(spilled, frames[6:9]), follow(half, frames[6:9]))

    bare = replace(busy, tracking=replace(busy.tracking, features=slam.FeaturesConfig(kind="none")))
    with pytest.raises(InputError, match="other settings"):
        slam.load(tmp_path, bare)
    file = tmp_path / STATE_FILE
    file.write_bytes(file.read_bytes()[:-4096])
    with pytest.raises(InputError, match="can't be read as a saved state"):
        slam.load(tmp_path, busy)
    with pytest.raises(InputError, match="can't be read"):
        slam.load(tmp_path / "nowhere", busy)


def test_arrays_of_every_kind_come_back(tmp_path, rng):
    arrays = [
        rng.random((3, 4)).astype(np.float32),
        np.zeros((0, 7)),
        np.asarray(5),
        np.asarray([True, False]),
    ]
    write_arrays(tmp_path / "a", arrays, name="x")
    found, facts = read_arrays(tmp_path / "a")
    assert facts == {"name": "x"}
    for a, b in zip(arrays, found, strict=True):
        assert a.dtype == b.dtype
        assert a.shape == b.shape
        np.testing.assert_array_equal(a, b)
