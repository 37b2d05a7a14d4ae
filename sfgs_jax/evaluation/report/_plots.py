"""Plots of a trajectory as SVG text."""

import io
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from sfgs_jax.evaluation.trajectory import Ate
from sfgs_jax.geometry import Trajectory

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure

_ESTIMATE, _TRUTH, _GRID, _START, _ERROR = "#2563eb", "#94a3b8", "#e2e8f0", "#16a34a", "#dc2626"

_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "sfgs_jax",
    "font.family": "sans-serif",
    "font.size": 10,
    "axes.edgecolor": "#cbd5e1",
    "axes.labelcolor": "#475569",
    "axes.titlecolor": "#0f172a",
    "xtick.color": "#64748b",
    "ytick.color": "#64748b",
    "text.color": "#334155",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": _GRID,
    "axes.axisbelow": True,
    "legend.frameon": False,
}

# A path that hardly moves still has a centimetre around it.
_LEAST_MARGIN_M = 0.01


def plot_paths(estimate: Trajectory, keyframes: Trajectory, truth: Trajectory | None) -> str:
    """Top and side view of the path, as SVG.

    Axes are those of the first camera: x to its right, y downwards, z forward. A level first view makes the
    top view a floor plan.

    Args:
        estimate: at least one pose.
        keyframes: poses to mark, in the same world frame.
        truth: ground truth aligned to it, or None.
    """
    import matplotlib
    from matplotlib.figure import Figure

    T_first_world = np.linalg.inv(estimate.poses[0])
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(10, 4.2), layout="constrained")
        top, side = figure.subplots(1, 2)
        for axes, title, (across, up), labels in (
            (top, "From above", (0, 2), ("x, right (m)", "z, forward (m)")),
            (side, "From the side", (2, 1), ("z, forward (m)", "y, down (m)")),
        ):
            if truth is not None:
                path = _points(T_first_world, truth)
                axes.plot(path[:, across], path[:, up], color=_TRUTH, linewidth=2.5, label="ground truth")
            path = _points(T_first_world, estimate)
            axes.plot(path[:, across], path[:, up], color=_ESTIMATE, linewidth=1.3, label="estimate")
            marks = _points(T_first_world, keyframes)
            axes.plot(marks[:, across], marks[:, up], ".", color=_ESTIMATE, markersize=5, label="keyframes")
            axes.plot(*path[0, [across, up]], "o", color=_START, markersize=6, label="start")
            axes.set_title(title, loc="left", fontweight="bold")
            axes.set_xlabel(labels[0])
            axes.set_ylabel(labels[1])
            _equal_scales(axes, path[:, [across, up]])
        side.invert_yaxis()
        handles, names = top.get_legend_handles_labels()
        figure.legend(handles, names, loc="outside lower center", ncols=len(names))
        return _svg(figure)


def plot_errors(
    absolute: Ate | None, deviations: tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]] | None
) -> str:
    """Position error over time, and three times the standard deviation that the run gives it, as SVG.

    Args:
        absolute: the errors; None without ground truth.
        deviations: time stamps, and standard deviations in metres; None if unknown. One of both is known.
    """
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(10, 2.4), layout="constrained")
        axes = figure.subplots()
        if deviations is not None:
            seconds, band = deviations[0] - deviations[0][0], 300 * deviations[1]
            axes.fill_between(seconds, band, color=_TRUTH, alpha=0.25, linewidth=0)
            axes.plot(seconds, band, color=_TRUTH, linewidth=1, label="3 σ from the first camera")
            axes.legend(loc="upper left")
        if absolute is not None:
            start = absolute.timestamps[0] if deviations is None else deviations[0][0]
            axes.plot(absolute.timestamps - start, 100 * absolute.errors_m, color=_ESTIMATE, linewidth=1.3)
            axes.axhline(100 * absolute.rmse_m, color=_ERROR, linewidth=1, linestyle="--")
            axes.set_title(f"RMSE {100 * absolute.rmse_m:.2f} cm", loc="right", color=_ERROR, fontsize=10)
        title = "Deviation of the position" if absolute is None else "Position error"
        axes.set_title(title, loc="left", fontweight="bold")
        axes.set_xlabel("time (s)")
        axes.set_ylabel("cm")
        axes.set_ylim(bottom=0)
        axes.margins(x=0.01)
        return _svg(figure)


def plot_quality(frames: dict[str, Float[np.ndarray, " n"]]) -> str:
    """PSNR of the scored frames over time, as SVG.

    Args:
        frames: columns of `frames.csv`, with at least one frame.
    """
    import matplotlib
    from matplotlib.figure import Figure

    seconds, views = frames["timestamp"] - frames["timestamp"].min(), frames["view"] > 0
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(10, 2.4), layout="constrained")
        axes = figure.subplots()
        known = np.isfinite(frames["psnr_gs_icp"])
        axes.plot(
            seconds[known], frames["psnr_gs_icp"][known], color=_ESTIMATE, linewidth=1.3, label="gs_icp"
        )
        for name, chosen, colour in (("views", views, _START), ("held_out", ~views, _ERROR)):
            marked = chosen & np.isfinite(frames[f"psnr_{name}"])
            axes.plot(
                seconds[marked],
                frames[f"psnr_{name}"][marked],
                ".",
                color=colour,
                markersize=5,
                label=f"{name}, every pixel",
            )
        axes.legend(loc="upper left", ncols=3)
        axes.set_title("PSNR", loc="left", fontweight="bold")
        axes.set_xlabel("time (s)")
        axes.set_ylabel("dB")
        axes.margins(x=0.01, y=0.25)
        return _svg(figure)


def plot_depth_correction(millimetres: Float[np.ndarray, "r c"]) -> str:
    """Correction of depth over the image, as SVG.

    Args:
        millimetres: at the nodes of a grid; positive where depth was measured too small.
    """
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(5, 3), layout="constrained")
        axes = figure.subplots()
        limit = max(float(np.abs(millimetres).max()), 1.0)
        image = axes.imshow(
            millimetres, cmap="RdBu_r", vmin=-limit, vmax=limit, aspect="auto", interpolation="bilinear"
        )
        axes.set_xticks([])
        axes.set_yticks([])
        axes.set_title("Correction of depth, mm", loc="left", fontweight="bold")
        figure.colorbar(image, ax=axes)
        return _svg(figure)


def _points(T_first_world: Float[np.ndarray, "4 4"], trajectory: Trajectory) -> Float[np.ndarray, "n 3"]:
    return trajectory.positions @ T_first_world[:3, :3].T + T_first_world[:3, 3]


def _equal_scales(axes: "matplotlib.axes.Axes", path: Float[np.ndarray, "n 2"]) -> None:
    """Give both axes one scale, and a short path some room."""
    axes.set_aspect("equal", adjustable="datalim")
    if np.ptp(path, axis=0).max() < _LEAST_MARGIN_M:
        # Data limits rather than axis limits: fixed axis limits contradict the equal scales.
        centre = path.mean(axis=0)
        axes.update_datalim([centre - _LEAST_MARGIN_M, centre + _LEAST_MARGIN_M])
        axes.margins(0)
        axes.autoscale_view()


def _svg(figure: "matplotlib.figure.Figure") -> str:
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None})
    # A page takes the <svg> element only, not the XML declaration before it.
    text = buffer.getvalue()
    return text[text.index("<svg") :]
