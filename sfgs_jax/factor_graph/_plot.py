"""A picture of a graph before and after."""

from pathlib import Path

import numpy as np

from sfgs_jax.arrays import checked
from sfgs_jax.factor_graph._values import Values
from sfgs_jax.factor_graph.problem._graph import FactorGraph

_PATH, _LOOP, _LANDMARK = "#2563eb", "#dc2626", "#94a3b8"


@checked
def plot_graph(graph: FactorGraph, before: Values, after: Values, path: Path | str) -> None:
    """Draw poses, links between poses that are not neighbours in time, and landmarks, from above.

    The two axes are those along which the poses spread most after the solve.

    Args:
        graph: factors to draw.
        before: poses and landmarks at the start.
        after: poses and landmarks at the end.
        path: image to write; its suffix decides the format.

    Raises:
        OSError: the file can't be written.
    """
    # Imported here: it takes long, and few programs draw.
    from matplotlib.figure import Figure

    used = np.asarray(graph.free_poses).copy()
    links = [np.zeros((0, 2), np.int64)]
    for factor in graph.factors:
        ends = np.asarray(factor.groups)[factor.group_valid]
        used[ends.reshape(-1)] = True
        if ends.shape[1] == 2:
            links.append(ends[np.abs(ends[:, 0] - ends[:, 1]) > 1])
    loops = np.concatenate(links)
    final = np.asarray(after.poses.wxyz_xyz)[:, 4:]
    across, up = sorted(np.argsort(-np.ptp(final[used], axis=0))[:2])
    figure = Figure(figsize=(10, 5), layout="constrained")
    for axes, values, title in zip(figure.subplots(1, 2), (before, after), ("Before", "After"), strict=True):
        positions = np.asarray(values.poses.wxyz_xyz)[:, 4:]
        landmarks = np.asarray(values.landmarks)[np.asarray(graph.free_landmarks)]
        axes.plot(landmarks[:, across], landmarks[:, up], ".", color=_LANDMARK, markersize=1)
        for a, b in loops:
            axes.plot(*positions[[a, b]][:, [across, up]].T, color=_LOOP, linewidth=0.5)
        axes.plot(positions[used, across], positions[used, up], color=_PATH, linewidth=1)
        axes.set_title(title, loc="left", fontweight="bold")
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel(f"{'xyz'[across]} (m)")
        axes.set_ylabel(f"{'xyz'[up]} (m)")
    figure.savefig(path)
