"""A state on disk: to save, to go on from, and to keep old images out of memory.

The images of keyframes and views never change, so each is written once, to a file of its own, and read back
by mapping that file into memory; all else is one file, written anew each time.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from sfgs_jax.geometry import Camera, InputError, se3
from sfgs_jax.slam.array_file import read_arrays, write_arrays
from sfgs_jax.slam.config import SlamConfig
from sfgs_jax.slam.nodes import Edge, Keyframe
from sfgs_jax.slam.observation import Observation, blank_observation
from sfgs_jax.slam.state import MapState, SlamState, View, init

STATE_FILE = "state.arrays"

_T = TypeVar("_T")


def save(state: SlamState, folder: Path | str, **facts: int) -> None:
    """Write a state; `load` gives it back. Of an earlier state of the same run only what is new is written.

    Args:
        state: what to save.
        folder: made if it is not there; it belongs to one run.
        facts: numbers to keep with it, for `saved_facts`.

    Raises:
        OSError: a file can't be written.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    _write_images(state, folder)
    rest = _without_images(state)
    counts = {
        "keyframes": len(state.keyframes),
        "edges": len(state.edges),
        "pending": len(state.pending),
        "candidates": len(state.candidates),
        "views": len(state.mapping.views),
        "last": int(state.last is not None),
    }
    camera = {"width": state.camera.width, "height": state.camera.height}
    write_arrays(folder / STATE_FILE, jax.tree.leaves(rest), counts=counts, camera=camera, given=facts)


def saved_facts(folder: Path | str) -> dict[str, int]:
    """The numbers that were given to `save`. Raises InputError as `load` does."""
    return read_arrays(Path(folder) / STATE_FILE)[1]["given"]


def load(folder: Path | str, config: SlamConfig) -> SlamState:
    """A state that was saved.

    Args:
        folder: where `save` wrote.
        config: the settings of the run that was saved.

    Raises:
        InputError: there is no state, it is damaged, or it was saved with other settings.
    """
    folder = Path(folder)
    leaves, facts = read_arrays(folder / STATE_FILE)
    template = _template(facts, config)
    expected, structure = jax.tree.flatten(template)
    if len(leaves) != len(expected):
        raise InputError(f"{folder} holds a state that was saved with other settings.")
    rest = jax.tree.unflatten(structure, [_like(a, b) for a, b in zip(leaves, expected, strict=True)])
    blank = blank_observation(rest.camera, config.tracking)
    keyframes = tuple(
        _with_images(keyframe, _read(_image_file(folder, "keyframe", i), blank))
        for i, keyframe in enumerate(rest.keyframes)
    )
    views = []
    for i, view in enumerate(rest.mapping.views):
        rgb, depth = _read(_image_file(folder, "view", i), (0, 0))
        views.append(eqx.tree_at(lambda v: (v.rgb, v.depth), view, (rgb, depth), is_leaf=lambda x: x is None))
    return replace(rest, keyframes=keyframes, mapping=replace(rest.mapping, views=tuple(views)))


def spill(state: SlamState, folder: Path) -> SlamState:
    """The state with the images of all but the newest keyframes and views on disk, not in memory."""
    kept = state.config.mapping.views_in_memory
    keyframes = list(state.keyframes)
    # What is beyond these was put away before.
    for i in _fresh(keyframes, kept, lambda k: k.observation.keypoints.depth):
        path = _image_file(folder, "keyframe", i)
        _write(path, keyframes[i].observation)
        keyframes[i] = replace(keyframes[i], observation=_read(path, keyframes[i].observation))
    mapping = spill_views(state.mapping, folder, kept)
    return replace(state, keyframes=tuple(keyframes), mapping=mapping)


def spill_views(mapping: MapState, folder: Path, kept: int) -> MapState:
    """The map state with the images of all but the newest views on disk, for a mapper of its own."""
    views = list(mapping.views)
    for i in _fresh(views, kept, lambda v: v.rgb):
        path = _image_file(folder, "view", i)
        _write(path, (views[i].rgb, views[i].depth))
        rgb, depth = _read(path, (0, 0))
        views[i] = replace(views[i], rgb=rgb, depth=depth)
    return replace(mapping, views=tuple(views))


def _fresh(items: list[Any], kept: int, leaf: Any) -> list[int]:
    return [i for i in range(len(items) - kept) if not isinstance(leaf(items[i]), np.memmap)]


def _write_images(state: SlamState, folder: Path) -> None:
    for i, keyframe in enumerate(state.keyframes):
        _write(_image_file(folder, "keyframe", i), keyframe.observation)
    for i, view in enumerate(state.mapping.views):
        _write(_image_file(folder, "view", i), (view.rgb, view.depth))


def _image_file(folder: Path, kind: str, number: int) -> Path:
    return folder / f"{kind}-{number:06d}.arrays"


def _write(path: Path, images: Any) -> None:
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_arrays(path, jax.tree.leaves(images))


def _read(path: Path, like: _T) -> _T:
    leaves, _ = read_arrays(path)
    structure = jax.tree.structure(like)
    if structure.num_leaves != len(leaves):
        raise InputError(f"{path} holds other images than this run's.")
    return jax.tree.unflatten(structure, leaves)


def _without_images(state: SlamState) -> SlamState:
    keyframes = tuple(_bare_keyframe(k) for k in state.keyframes)
    views = tuple(_bare_view(v) for v in state.mapping.views)
    return replace(state, keyframes=keyframes, mapping=replace(state.mapping, views=views))


def _with_images(keyframe: Keyframe, observation: Observation) -> Keyframe:
    return eqx.tree_at(lambda k: k.observation, keyframe, observation, is_leaf=lambda x: x is None)


def _bare_keyframe(keyframe: Keyframe) -> Keyframe:
    return eqx.tree_at(lambda k: k.observation, keyframe, None)


def _bare_view(view: View) -> View:
    return eqx.tree_at(lambda v: (v.rgb, v.depth), view, (None, None))


def _template(facts: dict[str, Any], config: SlamConfig) -> SlamState:
    """A state of the same structure; its leaves say what kind each is: an array, a number or a flag."""
    zero = jnp.zeros(())
    camera = Camera(zero, zero, zero, zero, **facts["camera"])
    state, counts, T = init(camera, config), facts["counts"], se3.identity()
    edge = Edge(0, 0, T, jnp.zeros((6, 6)), jnp.zeros((6, 6)), False)
    blank = blank_observation(camera, config.tracking)
    keyframe = _bare_keyframe(Keyframe(blank, T, np.zeros(0, np.int64), 0))
    view = _bare_view(View(np.zeros((0, 0, 3), np.uint8), np.zeros((0, 0), np.float32), 0, T, 0))
    return replace(
        state,
        keyframes=(keyframe,) * counts["keyframes"],
        edges=(edge,) * counts["edges"],
        pending=((0, 0),) * counts["pending"],
        candidates=(edge,) * counts["candidates"],
        last=blank if counts["last"] else None,
        mapping=replace(state.mapping, views=(view,) * counts["views"]),
    )


def _like(value: np.ndarray, kind: Any) -> Any:
    """A leaf as what it was: Python numbers are static to compiled programs, arrays are not."""
    if isinstance(kind, bool | int | float):
        return type(kind)(value)
    return np.array(value) if isinstance(kind, np.ndarray) else jnp.asarray(value)
