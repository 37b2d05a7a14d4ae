"""Pose graphs in g2o's text format: SE3 vertices and edges between them."""

import math
from dataclasses import dataclass
from pathlib import Path

import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Bool, Float, Int

from sfgs_jax.arrays import InputError, checked, excerpt, file_bytes, write_atomically
from sfgs_jax.factor_graph._values import Values
from sfgs_jax.factor_graph.factors._pose_factors import RelativePose
from sfgs_jax.factor_graph.start._spanning_tree import spanning_tree_start

_VERTEX, _EDGE, _FIX = "VERTEX_SE3:QUAT", "EDGE_SE3:QUAT", "FIX"
_UPPER = np.triu_indices(6)
# Beyond it float32 ends soon.
_LARGEST = 1e30
_LEAST_QUATERNION = 1e-15
_LONGEST = 40


@dataclass(frozen=True)
class PoseGraph:
    """Contents of a g2o file."""

    values: Values
    """Poses in the order of their vertices' numbers; no landmarks."""

    edges: RelativePose
    """Measured motions with their information, in the order of the file."""

    vertices: Int[np.ndarray, " P"]
    """(P,) the file's own number of each vertex."""

    fixed: Bool[np.ndarray, " P"]
    """(P,) poses named by FIX; none if the file names none."""


@checked
def read_g2o(path: Path | str) -> PoseGraph:
    """Read a graph of `VERTEX_SE3:QUAT`, `EDGE_SE3:QUAT` and `FIX` lines; `PARAMS_` lines are skipped.

    Quaternions are xyzw in the file, of any length, and wxyz in memory. The rotation part of g2o's error is
    the vector part of a quaternion. Here it is the rotation vector, twice as long to first order. Information
    of rotations is therefore divided by 4, and that between rotations and translations by 2, so costs agree
    near a solution. A file without vertices gets its poses from `spanning_tree_start`.

    Raises:
        InputError: the file can't be read; a line of another kind, or one that can't be read; a pose that is
            missing; an information matrix with a negative eigenvalue.
    """
    lines = _read_lines(path)
    touched = {v for pair in lines.ends for v in pair}
    vertices = np.array(sorted(lines.poses or touched), np.int64)
    if not len(vertices):
        raise InputError(f"{path} holds no poses: it has neither a {_VERTEX} nor an {_EDGE} line.")
    unknown = (touched | lines.fixed).difference(vertices.tolist())
    if unknown:
        raise InputError(f"{path} has no {_VERTEX} line for vertex {min(unknown)}.")
    rows = np.asarray(lines.edges, np.float64).reshape(-1, 28)
    information = np.zeros((len(rows), 6, 6))
    information[:, _UPPER[0], _UPPER[1]] = rows[:, 7:]
    information[:, _UPPER[1], _UPPER[0]] = rows[:, 7:]
    _require_information(information, lines, path)
    half = np.array([1, 1, 1, 0.5, 0.5, 0.5])
    measured = RelativePose(
        np.searchsorted(vertices, np.array(lines.ends, np.int64).reshape(-1, 2)),
        _motions(rows[:, :7]),
        jnp.asarray(information * half[:, None] * half, jnp.result_type(float)),
    )
    if lines.poses:
        values = Values(_motions(np.array([lines.poses[v] for v in vertices.tolist()])))
    else:
        values = spanning_tree_start(measured, len(vertices))
    return PoseGraph(values, measured, vertices, np.isin(vertices, list(lines.fixed)))


@checked
def write_g2o(path: Path | str, graph: PoseGraph) -> None:
    """Write a graph that `read_g2o` reads back; masked edges are left out.

    Args:
        path: file to write; it is replaced when it is complete.
        graph: poses and edges.

    Raises:
        OSError: the file can't be written; an older one is as it was.
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


@dataclass
class _Lines:
    """Numbers of a file's lines: poses by vertex, ends, rows and lines of edges, fixed vertices."""

    poses: dict[int, list[float]]
    ends: list[tuple[int, int]]
    edges: list[list[float]]
    numbers: list[int]
    fixed: set[int]


def _read_lines(path: Path | str) -> _Lines:
    lines = _Lines({}, [], [], [], set())
    try:
        # Bytes that are no text end in a line of an unknown kind.
        text = file_bytes(path).decode("utf-8", errors="replace")
    except (OSError, ValueError) as error:
        raise InputError(f"Cannot read the graph {path}: {excerpt(error)}.") from error
    for number, line in enumerate(text.splitlines(), start=1):
        tag, *words = line.split("#")[0].split() or [""]
        where = f"line {number} of {path}"
        try:
            if tag == _VERTEX:
                if _whole(words[0]) in lines.poses:
                    raise InputError(f"Cannot read {where}: vertex {excerpt(words[0])} is there already.")
                lines.poses[_whole(words[0])] = _numbers(words[1:], 7)
            elif tag == _EDGE:
                lines.ends.append((_whole(words[0]), _whole(words[1])))
                lines.edges.append(_numbers(words[2:], 28))
                lines.numbers.append(number)
            elif tag == _FIX:
                lines.fixed.update(map(_whole, words))
            elif tag and not tag.startswith("PARAMS_"):
                raise InputError(
                    f"Cannot read {where}: {excerpt(tag[:_LONGEST])} is not one of {_VERTEX}, {_EDGE}, "
                    f"{_FIX}; convert the graph to 3-D poses and edges between them."
                )
        except (ValueError, IndexError):
            raise InputError(f"Cannot read {where}: {tag} needs other numbers than it has.") from None
    return lines


def _require_information(information: Float[np.ndarray, "n 6 6"], lines: _Lines, path: Path | str) -> None:
    """Raise InputError at the first edge whose information is not the inverse of a covariance."""
    eigenvalues = np.linalg.eigvalsh(information)
    # Files round their numbers.
    wrong = eigenvalues[:, 0] < -1e-4 * np.maximum(eigenvalues[:, -1], 0)
    if wrong.any():
        number = lines.numbers[int(np.argmax(wrong))]
        raise InputError(
            f"Cannot read line {number} of {path}: its information is no inverse of a covariance, for it has "
            "a negative eigenvalue."
        )


def _whole(word: str) -> int:
    """A whole number of 64 bits at most."""
    number = int(word) if len(word) < 20 else 2**63
    if not -(2**63) <= number < 2**63:
        raise ValueError
    return number


def _numbers(words: list[str], count: int) -> list[float]:
    """A count of numbers that float32 can hold; the first seven are a motion, whose quaternion is not 0."""
    numbers = [float(word) for word in words]
    if len(numbers) != count or not all(abs(x) < _LARGEST for x in numbers):
        raise ValueError
    if not math.hypot(*numbers[3:7]) > _LEAST_QUATERNION:
        raise ValueError
    return numbers


def _motions(rows: Float[np.ndarray, "n 7"]) -> jaxlie.SE3:
    """Motions of rows tx ty tz qx qy qz qw."""
    wxyz = rows[:, [6, 3, 4, 5]]
    wxyz = wxyz / np.linalg.norm(wxyz, axis=1, keepdims=True)
    return jaxlie.SE3(jnp.asarray(np.concatenate([wxyz, rows[:, :3]], axis=1), jnp.result_type(float)))


def _motion_words(wxyz_xyz: Float[np.ndarray, "7"]) -> str:
    return " ".join(f"{x:.9g}" for x in wxyz_xyz[[4, 5, 6, 1, 2, 3, 0]])
