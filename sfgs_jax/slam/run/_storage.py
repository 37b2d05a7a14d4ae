"""A state on disk: to save, to go on from, and to keep old images out of memory.

The images of views never change, and those of keyframes hardly ever. Each is written once, to a file of its
own, and read back by mapping that file into memory. The rest is one file, written anew each time, which names
every array.
"""

import dataclasses
import json
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from sfgs_jax.arrays import InputError, checked, make_folder, sync_folder
from sfgs_jax.geometry import Camera, same_camera, se3
from sfgs_jax.slam._init import init
from sfgs_jax.slam.config import SlamConfig
from sfgs_jax.slam.frontend import feature_shapes
from sfgs_jax.slam.run._tensor_file import read_tensors, write_tensors
from sfgs_jax.slam.state import (
    Adjustment,
    Edge,
    Keyframe,
    MapState,
    PendingAdjustment,
    SlamState,
    Submap,
    TrackedPair,
    View,
    empty_map,
)

STATE_FILE = "state.safetensors"
FORMAT_VERSION = 33
_FORMER_STATE_FILE = "state.arrays"
"""Written by version 0.1.0, whose arrays had no names."""

_T = TypeVar("_T")


@checked
def save(state: SlamState, folder: Path | str, **facts: int) -> None:
    """Write a state; `load` gives it back. Images that are on disk already are not written again.

    Args:
        state: the state to save.
        folder: made if it is not there; it belongs to one run.
        facts: numbers to keep with it, for `saved_facts`.

    Raises:
        OSError: a file can't be written.
    """
    folder = Path(folder)
    make_folder(folder, private=True)
    for i, keyframe in enumerate(state.graph.keyframes):
        _write_once(_keyframe_file(folder, i, keyframe), keyframe.features)
    for i, view in enumerate(state.mapping.views):
        _write_once(_image_file(folder, "view", i), _images(view))
    for submap in state.mapping.submaps:
        _write_once(_submap_file(folder, submap), submap.content)
    # The images have their names before the state that names them.
    sync_folder(folder)
    counts = {
        "keyframes": len(state.graph.keyframes),
        "edges": len(state.graph.edges),
        "tracked": len(state.graph.tracked),
        "pending": len(state.graph.pending),
        "again": len(state.graph.again),
        "candidates": len(state.graph.candidates),
        "adjustments": 0 if state.graph.adjustment is None else 1,
        "views": len(state.mapping.views),
        "submaps": len(state.mapping.submaps),
    }
    metadata = {
        "version": str(FORMAT_VERSION),
        "config": _config_text(state.config),
        "size": json.dumps([state.camera.width, state.camera.height]),
        "counts": json.dumps(counts),
        "facts": json.dumps(facts),
    }
    write_tensors(folder / STATE_FILE, _named(_without_images(state)), metadata)
    _remove_former(state, folder)


def _remove_former(state: SlamState, folder: Path) -> None:
    """Remove the files of submaps that have come back into the map, and of keyframes rectified anew since.

    No state on disk names them any more. Newer ones stay: a map in a thread of its own may have written them.
    """
    known = _named_files(state, folder)
    made = {"keyframe": len(state.graph.keyframes), "submap": state.mapping.num_submaps}
    for kind, number in made.items():
        for path in set(folder.glob(f"{kind}-*.safetensors")) - known:
            if int(path.stem.rpartition("-")[2]) < number:
                with suppress(OSError):
                    path.unlink()


def saved_facts(folder: Path | str) -> dict[str, int]:
    """The numbers that were given to `save`. Raises InputError as `load` does.

    Args:
        folder: where `save` wrote.
    """
    return json.loads(_read_state(Path(folder))[1]["facts"])


@checked
def load(folder: Path | str, config: SlamConfig, camera: Camera | None = None) -> SlamState:
    """A state that was saved.

    Args:
        folder: where `save` wrote.
        config: settings of the run that was saved.
        camera: its camera, to make sure that it is the same; not compared if not given.

    Raises:
        InputError: there is no state, it is damaged, of another version, or was saved with other settings or
            another camera.
    """
    folder = Path(folder)
    tensors, metadata = _read_state(folder)
    if metadata["config"] != _config_text(config):
        raise InputError(f"{folder} holds a state that was saved with other settings.")
    template = _template(metadata, config)
    rest = _filled(template, tensors, folder)
    if camera is not None and not same_camera(camera, rest.camera):
        raise InputError(f"{folder} holds a state that was saved with another camera.")
    shapes = feature_shapes(rest.params)
    keyframes = tuple(
        replace(keyframe, features=_read_images(_keyframe_file(folder, i, keyframe), shapes))
        for i, keyframe in enumerate(rest.graph.keyframes)
    )
    views = tuple(
        _with_images(view, _image_file(folder, "view", i)) for i, view in enumerate(rest.mapping.views)
    )
    submaps = tuple(_mapped(submap, _submap_file(folder, submap)) for submap in rest.mapping.submaps)
    return replace(
        rest,
        graph=replace(rest.graph, keyframes=keyframes),
        mapping=replace(rest.mapping, views=views, submaps=submaps),
    )


def spill(state: SlamState, folder: Path, *, before: SlamState | None = None) -> SlamState:
    """The state with the images of all but the newest keyframes on disk, not in memory.

    Args:
        state: with all images in memory, or some.
        folder: made if it is not there; it belongs to one run.
        before: an earlier state of the run that this function gave back. Only keyframes that have changed
            since are looked at: in a long run there are thousands.
    """
    keyframes, kept = list(state.graph.keyframes), state.config.mapping.views_in_memory
    known = () if before is None else before.graph.keyframes[: -kept or None]
    old = range(len(keyframes) - kept)
    for i in (i for i in old if i >= len(known) or keyframes[i] is not known[i]):
        if isinstance(keyframes[i].features.keypoints.depth, np.memmap):
            continue
        path = _keyframe_file(folder, i, keyframes[i])
        _write_once(path, keyframes[i].features)
        keyframes[i] = replace(keyframes[i], features=_read_images(path, keyframes[i].features))
    return replace(state, graph=replace(state.graph, keyframes=tuple(keyframes)))


def spill_views(mapping: MapState, folder: Path, kept: int) -> MapState:
    """The map state with submaps and the images of all but the newest views on disk, not in memory.

    Args:
        mapping: before.
        folder: made if it is not there; it belongs to one run.
        kept: newest views that stay in memory.
    """
    views = list(mapping.views)
    for i in _in_memory(views, kept, lambda v: v.rgb):
        path = _image_file(folder, "view", i)
        _write_once(path, _images(views[i]))
        views[i] = _with_images(views[i], path)
    submaps = list(mapping.submaps)
    for i in _in_memory(submaps, 0, lambda s: s.content.updates):
        path = _submap_file(folder, submaps[i])
        _write_once(path, submaps[i].content)
        submaps[i] = _mapped(submaps[i], path)
    return replace(mapping, views=tuple(views), submaps=tuple(submaps))


def remove_other_images(state: SlamState, folder: Path) -> None:
    """Remove the images of keyframes and views that a state does not have.

    A run that was killed has left those that are newer than its checkpoint. They may be damaged, and would be
    taken for the images of the keyframes and views to come.

    Args:
        state: the state that its run goes on from.
        folder: its images; one that is not there holds none.

    Raises:
        OSError: a file can't be removed.
    """
    known = _named_files(state, folder)
    for kind in ("keyframe", "view", "submap"):
        for path in set(folder.glob(f"{kind}-*.safetensors")) - known:
            path.unlink()


def _named_files(state: SlamState, folder: Path) -> set[Path]:
    files = {_keyframe_file(folder, i, keyframe) for i, keyframe in enumerate(state.graph.keyframes)}
    files |= {_image_file(folder, "view", i) for i in range(len(state.mapping.views))}
    return files | {_submap_file(folder, submap) for submap in state.mapping.submaps}


def _images(view: View) -> tuple[Any, Any, Any]:
    return view.rgb, view.depth, view.valid


def _with_images(view: View, path: Path) -> View:
    rgb, depth, valid = _read_images(path, (0, 0, 0))
    return replace(view, rgb=rgb, depth=depth, valid=valid)


def _in_memory(items: list[Any], kept: int, leaf: Any) -> list[int]:
    """Indices of the older items that are still in memory."""
    return [i for i in range(len(items) - kept) if not isinstance(leaf(items[i]), np.memmap)]


def _keyframe_file(folder: Path, number: int, keyframe: Keyframe) -> Path:
    return _image_file(folder, "keyframe" if not keyframe.edition else f"keyframe-{keyframe.edition}", number)


def _image_file(folder: Path, kind: str, number: int) -> Path:
    return folder / f"{kind}-{number:06d}.safetensors"


def _submap_file(folder: Path, submap: Submap) -> Path:
    return _image_file(folder, "submap", submap.number)


def _mapped(submap: Submap, path: Path) -> Submap:
    return replace(submap, content=_read_images(path, empty_map(1)))


def _write_once(path: Path, images: Any) -> None:
    if not path.exists():
        make_folder(path.parent, private=True)
        write_tensors(path, _named(images), {"name": path.name}, sync_name=False)


def _read_images(path: Path, like: _T) -> _T:
    tensors, metadata = read_tensors(path)
    names = list(_named(like))
    if set(names) != set(tensors) or metadata.get("name") != path.name:
        raise InputError(f"{path} holds other images than this run's.")
    return jax.tree.unflatten(jax.tree.structure(like), [tensors[name] for name in names])


def _named(tree: Any) -> dict[str, Any]:
    """The leaves of a tree by their key paths."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(tree)
    return {jax.tree_util.keystr(path): leaf for path, leaf in leaves}


def _without_images(state: SlamState) -> SlamState:
    keyframes = tuple(_bare_keyframe(k) for k in state.graph.keyframes)
    views = tuple(_bare_view(v) for v in state.mapping.views)
    submaps = tuple(_bare_submap(s) for s in state.mapping.submaps)
    return replace(
        state,
        graph=replace(state.graph, keyframes=keyframes),
        mapping=replace(state.mapping, views=views, submaps=submaps),
    )


def _read_state(folder: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    if (folder / _FORMER_STATE_FILE).exists() and not (folder / STATE_FILE).exists():
        raise InputError(
            f"{folder} holds a state of an earlier version of sfgs_jax: start the run again with --overwrite."
        )
    if not (folder / STATE_FILE).exists():
        raise InputError(
            f"{folder} holds no checkpoint, since the run was stopped before its first one was complete: "
            "start it again with --overwrite."
        )
    tensors, metadata = read_tensors(folder / STATE_FILE)
    if metadata.get("version") != str(FORMAT_VERSION):
        raise InputError(
            f"{folder} holds a state of format {metadata.get('version')}, this version reads format "
            f"{FORMAT_VERSION}: start the run again with --overwrite."
        )
    return tensors, metadata


def _filled(template: SlamState, tensors: dict[str, np.ndarray], folder: Path) -> SlamState:
    """The template with the arrays of a file, matched by name and kind."""
    expected = _named(template)
    for name in sorted(set(expected) ^ set(tensors)):
        known = "lacks" if name in expected else "holds an unknown"
        raise InputError(f"The state in {folder} {known} array {name}: it is of another version.")
    leaves = []
    for name, kind in expected.items():
        if tensors[name].dtype != np.asarray(kind).dtype:
            raise InputError(f"The state in {folder} holds {name} as {tensors[name].dtype}: it is damaged.")
        leaves.append(_like(tensors[name], kind))
    return jax.tree.unflatten(jax.tree.structure(template), leaves)


def _template(metadata: dict[str, str], config: SlamConfig) -> SlamState:
    """A state of the same structure; its leaves tell arrays, numbers and flags apart."""
    width, height = json.loads(metadata["size"])
    one, counts = jnp.ones(()), json.loads(metadata["counts"])
    state = init(Camera(one, one, one, one, width=width, height=height), config)
    motion, matrix = np.zeros(7, np.float32), np.zeros((6, 6), np.float32)
    parameters = state.graph.depth_parameters
    sensitivity = np.zeros((6, len(parameters)))
    edge = Edge(0, 0, motion, matrix, motion, matrix, False, False, parameters, sensitivity, sensitivity)
    shapes = feature_shapes(state.params)
    keyframe = _bare_keyframe(
        Keyframe(shapes, np.zeros(0, np.int64), 0, 0, motion, parameters, motion[:6], motion[:3], 0)
    )
    none = np.zeros((0, 0), np.float32)
    image, gain = np.zeros((0, 0, 3), np.uint8), motion[:3]
    view = View(image, none, none > 0, motion[:6], 0, se3.identity(), 0, gain, motion[:6], False)
    graph = replace(
        state.graph,
        keyframes=(keyframe,) * counts["keyframes"],
        edges=(edge,) * counts["edges"],
        tracked=(TrackedPair(0, 0, state.tracker.last_registration),) * counts["tracked"],
        pending=((0, 0),) * counts["pending"],
        again=((0, 0),) * counts["again"],
        candidates=(edge,) * counts["candidates"],
        adjustment=_blank_adjustment() if counts["adjustments"] else None,
    )
    submap = _bare_submap(Submap(state.mapping.map, 0, 0, np.zeros((2, 3), np.float32)))
    mapping = replace(
        state.mapping,
        views=(_bare_view(view),) * counts["views"],
        submaps=(submap,) * counts["submaps"],
    )
    return replace(state, graph=graph, mapping=mapping)


def _blank_adjustment() -> PendingAdjustment:
    none = np.zeros(0, np.int64)
    found = Adjustment(
        poses=np.zeros((0, 7), np.float32),
        members=none,
        anchor=0,
        covariances=np.zeros((0, 6, 6)),
        landmarks=none,
        points=np.zeros((0, 3), np.float32),
    )
    return PendingAdjustment(found, 0)


def _bare_keyframe(keyframe: Keyframe) -> Keyframe:
    return eqx.tree_at(lambda k: k.features, keyframe, None)


def _bare_submap(submap: Submap) -> Submap:
    return eqx.tree_at(lambda s: s.content, submap, None)


def _bare_view(view: View) -> View:
    return eqx.tree_at(_images, view, (None, None, None))


def _like(value: np.ndarray, kind: Any) -> Any:
    """A leaf of its former kind: Python numbers are static to compiled programs, arrays are not."""
    if isinstance(kind, bool | int | float):
        return type(kind)(value)
    copy = np.array(value)
    # Put on the device as it is: `jnp.asarray` would compile a program for each shape.
    return copy if isinstance(kind, np.ndarray) else jax.device_put(copy)


def _config_text(config: SlamConfig) -> str:
    return json.dumps(dataclasses.asdict(config), sort_keys=True)
