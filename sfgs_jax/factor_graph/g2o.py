"""Pose graphs in g2o's text format: SE3 vertices and edges between them."""

from dataclasses import dataclass
from pathlib import Path

import jax.numpy as jnp
import jaxlie
import numpy as np

from sfgs_jax.factor_graph.odometry import odometry_start
from sfgs_jax.factor_graph.pose_factors import RelativePose
from sfgs_jax.factor_graph.values import Values
from sfgs_jax.geometry import InputError, write_atomically

_VERTEX, _EDGE, _FIX = "VERTEX_SE3:QUAT", "EDGE_SE3:QUAT", "FIX"
_UPPER = np.triu_indices(6)


@dataclass(frozen=True)
class PoseGraph:
    """What a g2o file holds."""

    values: Values
    """Poses in the order of their vertices' numbers; no landmarks."""

    edges: RelativePose
    """Measured motions with their information, in the order of the file."""

    vertices: np.ndarray
    """(P,) the file's own number of each vertex."""

    fixed: np.ndarray
    """(P,) poses named by FIX; if the file names none, none."""


def read_g2o(path: Path | str) -> PoseGraph:
    """Read a graph of `VERTEX_SE3:QUAT`, `EDGE_SE3:QUAT` and `FIX` lines; sensors' `PARAMS_` are passed over.

    Quaternions are xyzw in the file, of any length, and wxyz in memory. g2o's error is the vector part of the
    quaternion where this library's is the rotation vector, twice as long to first order: information of
    rotations is divided by 4, and by 2 where it couples them with translations, so that costs agree near a
    solution. A file of edges alone gets its poses from `odometry_start`.

    Raises:
        InputError: a line that is not of these kinds, or that can't be read; a pose that is missing.
        OSError: the file can't be read.
    """
    poses: dict[int, list[float]] = {}
    ends: list[tuple[int, int]] = []
    edges: list[list[float]] = []
    fixed: set[int] = set()
    # Bytes that are no text end in a line of an unknown kind.
    with open(path, encoding="utf-8", errors="replace") as file:
        for number, line in enumerate(file, start=1):
            tag, *words = line.split("#")[0].split() or [""]
            where = f"line {number} of {path}"
            try:
                if tag == _VERTEX:
                    if int(words[0]) in poses:
                        raise InputError(f"Cannot read {where}: vertex {words[0]} is there already.")
                    poses[int(words[0])] = _numbers(words[1:], 7)
                elif tag == _EDGE:
                    ends.append((int(words[0]), int(words[1])))
                    edges.append(_numbers(words[2:], 28))
                elif tag == _FIX:
                    fixed.update(int(word) for word in words)
                elif tag and not tag.startswith("PARAMS_"):
                    raise InputError(
                        f"Cannot read {where}: {tag} is not one of {_VERTEX}, {_EDGE}, {_FIX}; convert the "
                        "graph to 3-D poses and edges between them."
                    )
            except (ValueError, IndexError):
                raise InputError(f"Cannot read {where}: {tag} needs other numbers than it has.") from None
    touched = {v for pair in ends for v in pair}
    vertices = np.array(sorted(poses or touched), np.int64)
    if not len(vertices):
        raise InputError(f"{path} holds no poses: it has neither a {_VERTEX} nor an {_EDGE} line.")
    unknown = (touched | fixed).difference(vertices.tolist())
    if unknown:
        raise InputError(f"{path} has no {_VERTEX} line for vertex {min(unknown)}.")
    rows = np.asarray(edges, np.float64).reshape(-1, 28)
    information = np.zeros((len(rows), 6, 6))
    information[:, _UPPER[0], _UPPER[1]] = rows[:, 7:]
    information[:, _UPPER[1], _UPPER[0]] = rows[:, 7:]
    half = np.array([1, 1, 1, 0.5, 0.5, 0.5])
    measured = RelativePose(
        np.searchsorted(vertices, np.array(ends, np.int64).reshape(-1, 2)),
        _motions(rows[:, :7]),
        jnp.asarray(information * half[:, None] * half, jnp.result_type(float)),
    )
    if poses:
        values = Values(_motions(np.array([poses[v] for v in vertices.tolist()])))
    else:
        values = odometry_start(measured, len(vertices))
    return PoseGraph(values, measured, vertices, np.isin(vertices, list(fixed)))


def write_g2o(path: Path | str, graph: PoseGraph) -> None:
    """Write a graph that `read_g2o` reads back; masked edges are left out.

    Raises:
        OSError: the file can't be written; what was there is as it was.
    """
    lines = [
        f"{_VERTEX} {v} {_motion_words(pose)}"
        for v, pose in zip(graph.vertices, np.asarray(graph.values.poses.wxyz_xyz, np.float64), strict=True)
    ]
    lines += [f"{_FIX} {v}" for v in graph.vertices[graph.fixed]]
    edges = graph.edges
    double = np.array([1, 1, 1, 2, 2, 2])
    information = np.asarray(edges.matrices, np.float64) * double[:, None] * double
    measured = np.asarray(edges.T_a_b.wxyz_xyz, np.float64)
    for i in np.flatnonzero(edges.valid):
        a, b = graph.vertices[np.asarray(edges.poses)[i]]
        upper = " ".join(f"{x:.9g}" for x in information[i][_UPPER])
        lines.append(f"{_EDGE} {a} {b} {_motion_words(measured[i])} {upper}")
    write_atomically(path, "".join(line + "\n" for line in lines))


def _numbers(words: list[str], count: int) -> list[float]:
    """So many finite numbers, the first seven of which are a motion."""
    numbers = [float(word) for word in words]
    if len(numbers) != count or not np.all(np.isfinite(numbers)) or not any(numbers[3:7]):
        raise ValueError
    return numbers


def _motions(rows: np.ndarray) -> jaxlie.SE3:
    """Motions of rows tx ty tz qx qy qz qw."""
    wxyz = rows[:, [6, 3, 4, 5]]
    wxyz = wxyz / np.linalg.norm(wxyz, axis=1, keepdims=True)
    return jaxlie.SE3(jnp.asarray(np.concatenate([wxyz, rows[:, :3]], axis=1), jnp.result_type(float)))


def _motion_words(wxyz_xyz: np.ndarray) -> str:
    return " ".join(f"{x:.9g}" for x in wxyz_xyz[[4, 5, 6, 1, 2, 3, 0]])
