"""Plots of a run in progress: time of each frame, PSNR, error of the position."""

from dataclasses import dataclass, field

import numpy as np
import viser
from jaxtyping import Float, Int, Shaped
from viser import uplot

from sfgs_jax.slam import Progress

_MOST_POINTS = 1500
_TEXT, _GRID, _FONT = "#9ca3af", "#374151", "11px sans-serif"


@dataclass
class History:
    """Times of the frames and PSNR of the newest ones.

    Attributes:
        frames: numbers of the frames.
        frame_ms: time that each took, milliseconds.
        tracking_ms: time of its tracking.
        steps: frames and final map steps done when a PSNR was measured.
        psnr: dB.
    """

    frames: list[int] = field(default_factory=list)
    frame_ms: list[float] = field(default_factory=list)
    tracking_ms: list[float] = field(default_factory=list)
    steps: list[int] = field(default_factory=list)
    psnr: list[float] = field(default_factory=list)
    _totals: tuple[float, float] = (0.0, 0.0)

    def add(self, progress: Progress) -> None:
        """Take note of a frame.

        Args:
            progress: of a frame or of a final step, which has no time of its own.
        """
        if progress.info is None:
            return
        watch = progress.run.stopwatch
        totals = watch.total("frame"), watch.total("tracking")
        self.frame_ms.append(1e3 * (totals[0] - self._totals[0]))
        self.tracking_ms.append(1e3 * (totals[1] - self._totals[1]))
        self._totals = totals
        # The last, because another thread takes as many of the others.
        self.frames.append(progress.run.num_frames - 1)


class LivePlots:
    """The plots in the panel that is open.

    Args:
        server: the viser server.
        with_truth: whether there is ground truth to know errors by.
    """

    def __init__(self, server: viser.ViserServer, *, with_truth: bool) -> None:
        self._times = _plot(
            server, "Time of a frame, ms", "frame", {"all": "#60a5fa", "tracking": "#f59e0b"}, log=True
        )
        self._psnr = _plot(server, "PSNR of the newest frame, dB", "frames, steps", {"PSNR": "#34d399"})
        self._errors = (
            _plot(server, "Position, cm", "frame", {"error": "#f87171", "3 sigma": "#9ca3af"})
            if with_truth
            else None
        )

    def show(
        self,
        history: History,
        frames: Int[np.ndarray, " n"],
        errors_m: Float[np.ndarray, " n"],
        bounds_m: Float[np.ndarray, " n"],
    ) -> None:
        """Draw everything up to now.

        Args:
            history: times and PSNR.
            frames: numbers of the frames with a known error.
            errors_m: of their positions, metres.
            bounds_m: three standard deviations of these, metres.
        """
        count = len(history.frames)
        times = (history.frames[:count], history.frame_ms[:count], history.tracking_ms[:count])
        _draw(self._times, *map(np.asarray, times))
        _draw(self._psnr, np.asarray(history.steps), np.asarray(history.psnr))
        if self._errors is not None:
            _draw(self._errors, frames, 100 * errors_m, 100 * bounds_m)


def _plot(
    server: viser.ViserServer, title: str, along: str, lines: dict[str, str], *, log: bool = False
) -> viser.GuiUplotHandle:
    """A plot that is hidden until there is something to draw: uPlot makes no use of an empty start."""
    grid, ticks = uplot.Axis_Grid(stroke=_GRID, width=1), uplot.Axis_Ticks(stroke=_GRID, size=4)
    across, up = (
        uplot.Axis(stroke=_TEXT, grid=grid, ticks=ticks, size=size, font=_FONT) for size in (26, 44)
    )
    series = (uplot.Series(label=name, stroke=colour, width=1.5) for name, colour in lines.items())
    return server.gui.add_uplot(
        (np.arange(2.0),) * (1 + len(lines)),
        (uplot.Series(label=along), *series),
        title=title,
        scales={"x": uplot.Scale(time=False), "y": uplot.Scale(distr=3 if log else 1)},
        axes=(across, up),
        legend=uplot.Legend(show=len(lines) > 1),
        height=120,
        visible=False,
    )


def _draw(plot: viser.GuiUplotHandle, *columns: Shaped[np.ndarray, " n"]) -> None:
    if len(columns[0]) < 2:
        return
    step = 1 + len(columns[0]) // _MOST_POINTS
    plot.data = tuple(column[::step].astype(np.float64) for column in columns)
    plot.visible = True
