"""States on disk: what is loaded is what was saved, and old images leave memory."""

import os
from dataclasses import replace

import jax
import numpy as np
import pytest

from sfgs_jax import slam
from sfgs_jax.arrays import InputError
from sfgs_jax.slam.run import FORMAT_VERSION, STATE_FILE, read_tensors, spill, spill_views, write_tensors


@pytest.fixture
def busy(config):
    """Settings that give views within a few frames, and keep few of their images in memory."""
    return replace(
        config,
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


def test_keyframes_that_are_new_or_changed_go_to_disk(room, frames, busy, tmp_path):
    before = spill(follow(slam.init(room.camera, busy), frames[:4]), tmp_path)
    state = follow(before, frames[4:7])
    keyframes = list(state.graph.keyframes)
    assert len(keyframes) > len(before.graph.keyframes)
    in_memory = jax.tree.map(np.array, keyframes[0].features)
    keyframes[0] = replace(keyframes[0], features=in_memory, edition=1)
    state = replace(state, graph=replace(state.graph, keyframes=tuple(keyframes)))
    for found in (spill(state, tmp_path, before=before), spill(state, tmp_path)):
        on_disk = [isinstance(k.features.keypoints.depth, np.memmap) for k in found.graph.keyframes]
        assert on_disk == [True] * (len(keyframes) - 1) + [False]
        assert_equal(found, state)


def test_a_saved_state_goes_on_to_the_same_end(room, frames, busy, tmp_path):
    half = follow(slam.init(room.camera, busy), frames[:6])
    assert len(half.graph.keyframes) > 1
    slam.save(half, tmp_path)
    again = slam.load(tmp_path, busy)
    assert jax.tree.structure(again) == jax.tree.structure(half)
    assert_equal(again, half)
    assert_equal(follow(again, frames[6:9]), follow(half, frames[6:9]))

    images = tmp_path / "images"
    spilled = replace(spill(half, images), mapping=spill_views(half.mapping, images, 1))
    on_disk = [isinstance(k.features.keypoints.depth, np.memmap) for k in spilled.graph.keyframes]
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
    with pytest.raises(InputError, match=r"holds no checkpoint, .* --overwrite"):
        slam.load(tmp_path / "nowhere", busy)


def test_a_keyframe_rectified_anew_after_a_save_is_saved_anew(room, frames, busy, tmp_path):
    state = follow(slam.init(room.camera, busy), frames[:2])
    slam.save(state, tmp_path)
    first, *rest = state.graph.keyframes
    keypoints = replace(first.features.keypoints, depth=first.features.keypoints.depth + 0.01)
    anew = replace(first, features=replace(first.features, keypoints=keypoints), edition=1)
    state = replace(state, graph=replace(state.graph, keyframes=(anew, *rest)))
    slam.save(state, tmp_path)
    assert_equal(slam.load(tmp_path, busy), state)
    assert len(list(tmp_path.glob("keyframe*"))) == len(state.graph.keyframes), (
        "what it was before takes no disk"
    )


def test_a_state_is_refused_by_name(room, frames, busy, tmp_path):
    state, _ = slam.step(slam.init(room.camera, busy), frames[0])
    slam.save(state, tmp_path, num_frames=1)
    tensors, metadata = read_tensors(tmp_path / STATE_FILE)
    assert ".tracker.num_keyframes" in tensors
    assert metadata["version"] == str(FORMAT_VERSION)

    def refused(changed, message, **facts):
        write_tensors(tmp_path / STATE_FILE, changed, metadata | facts)
        with pytest.raises(InputError, match=message):
            slam.load(tmp_path, busy)

    renamed = {name.replace("num_keyframes", "count"): value for name, value in tensors.items()}
    refused(renamed, r"unknown array \.tracker\.count|lacks array \.tracker\.num_keyframes")
    wrong = tensors | {".tracker.num_keyframes": np.asarray(1.0)}
    refused(wrong, r"holds \.tracker\.num_keyframes as float64")
    refused(tensors, "of format 2", version="2")
    (tmp_path / STATE_FILE).unlink()
    (tmp_path / "state.arrays").write_bytes(b"{}")
    with pytest.raises(InputError, match="earlier version"):
        slam.load(tmp_path, busy)


def test_a_run_is_resumed_only_with_its_camera_and_settings(room, frames, busy, tmp_path):
    state, _ = slam.step(slam.init(room.camera, busy), frames[0])
    slam.save(state, tmp_path)
    slam.load(tmp_path, busy, room.camera)
    other = replace(room.camera, fx=room.camera.fx * 1.1)
    with pytest.raises(InputError, match="another camera"):
        slam.load(tmp_path, busy, other)
    with pytest.raises(InputError, match="another camera"):
        slam.run(iter([]), other, busy, resumed=slam.Run(state))
    settings = replace(busy, seed=1)
    with pytest.raises(InputError, match="other settings"):
        slam.load(tmp_path, settings)
    with pytest.raises(InputError, match="other settings"):
        slam.run(iter([]), room.camera, settings, resumed=slam.Run(state))


def test_arrays_of_every_kind_come_back(tmp_path, rng):
    arrays = {
        "matrix": rng.random((3, 4)).astype(np.float32),
        "empty": np.zeros((0, 7)),
        "number": np.asarray(5),
        "flags": np.asarray([True, False]),
    }
    write_tensors(tmp_path / "a", arrays, {"name": "x"})
    found, metadata = read_tensors(tmp_path / "a")
    assert metadata == {"name": "x"}
    for name, a in arrays.items():
        assert a.dtype == found[name].dtype
        assert a.shape == found[name].shape
        np.testing.assert_array_equal(a, found[name])


def test_every_damage_to_a_file_is_found(tmp_path, rng):
    path = tmp_path / "a"
    write_tensors(
        path, {"matrix": rng.random((3, 4)).astype(np.float32), "flag": np.asarray(True)}, {"name": "x"}
    )
    content = path.read_bytes()
    flipped = [
        content[:i] + bytes([content[i] ^ 1 << bit]) + content[i + 1 :]
        for i in range(len(content))
        for bit in (0, 6)
    ]
    cut = [content[:i] for i in range(len(content))]
    half = len(content) // 2
    zeroed = [
        content[:half] + bytes(len(content) - half),
        bytes(len(content)),
        content + b"\0",
        b"[" * 10_000,
    ]
    for damaged in (*flipped, *cut, *zeroed):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="can't be read as a saved state") as caught:
            read_tensors(path)
        assert len(str(caught.value).replace(str(path), "")) < 250
    path.write_bytes(content)
    assert read_tensors(path)[0]["flag"]


def test_a_file_in_anothers_place_is_found(room, frames, busy, tmp_path):
    state = follow(slam.init(room.camera, busy), frames[:3])
    slam.save(state, tmp_path)
    first, second, *_ = sorted(tmp_path.glob("view-*"))
    first.write_bytes(second.read_bytes())
    with pytest.raises(InputError, match="other images"):
        slam.load(tmp_path, busy)


def test_a_full_disk_does_not_end_a_run(room, frames, busy, tmp_path):
    (tmp_path / "file").write_text("no folder")
    found = slam.run(enumerate(frames[:6]), room.camera, busy, storage=tmp_path / "file")
    assert "exists" in found.storage_failure or "directory" in found.storage_failure
    assert found.num_frames == 6
    assert len(found.state.mapping.views) > 1
    assert not any(isinstance(view.rgb, np.memmap) for view in found.state.mapping.views)


def test_images_that_are_newer_than_the_checkpoint_do_not_spoil_the_next(room, frames, busy, tmp_path):
    offered = list(enumerate(frames[:4]))
    slam.save_run(slam.run(offered[:2], room.camera, busy), tmp_path)
    named = {path.name for path in tmp_path.iterdir()}
    # The killed run went on, put more images on the disk, and the last of them were damaged.
    slam.save_run(slam.run(offered, room.camera, busy, storage=tmp_path / "more"), tmp_path / "more")
    newer = [path for path in (tmp_path / "more").iterdir() if path.name not in named]
    assert {path.name.split("-")[0] for path in newer} == {"view", "keyframe"}
    for path in newer:
        (tmp_path / path.name).write_bytes(path.read_bytes()[:-1])
    resumed = slam.load_run(tmp_path, busy)
    found = slam.run(offered[2:], room.camera, busy, storage=tmp_path, resumed=resumed)
    assert found.storage_failure == ""
    slam.save_run(found, tmp_path)
    assert_equal(slam.load_run(tmp_path, busy).state, found.state)


def test_a_run_that_is_taken_up_again_clears_up(tmp_path):
    with pytest.raises(InputError, match=r"before its first checkpoint; --overwrite"):
        slam.resume_folder(tmp_path)
    (tmp_path / "state").mkdir()
    left = [".config.json.ab12cd_9", "state/.view-000001.safetensors.abcdefgh"]
    others = [".profile", ".my.config", "state/view-000001.safetensors"]
    for name in left + others:
        (tmp_path / name).write_text("")
    assert slam.resume_folder(tmp_path) == tmp_path / "state"
    assert not any((tmp_path / name).exists() for name in left)
    assert all((tmp_path / name).exists() for name in others)


def test_only_the_user_may_look_into_a_state(room, frames, busy, tmp_path):
    umask = os.umask(0)
    try:
        slam.save(follow(slam.init(room.camera, busy), frames[:1]), tmp_path / "out" / "state")
    finally:
        os.umask(umask)
    assert (tmp_path / "out" / "state").stat().st_mode & 0o777 == 0o700
