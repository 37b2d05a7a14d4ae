"""Plots of a run in progress: time of each frame, PSNR, error of the position."""

from dataclasses import dataclass, field

import numpy as np
import viser
from jaxtyping import Float, Int, Shaped
from viser import uplot

from sfgs_jax.slam import Progress

_MOST_POINTS = 1500
_AFTER_PICTURE = 1e9
"""Order of the plots; viser counts up from small numbers."""
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
        tab: where they are.
        with_truth: whether there is ground truth to know errors by.
    """

    def __init__(self, server: viser.ViserServer, tab: viser.GuiTabHandle, *, with_truth: bool) -> None:
        self._times = _Plot(
            server,
            tab,
            1,
            "Time of a frame, ms",
            "frame",
            {"all": "#60a5fa", "tracking": "#f59e0b"},
            log=True,
        )
        self._psnr = _Plot(
            server, tab, 2, "PSNR of the newest frame, dB", "frames, steps", {"PSNR": "#34d399"}
        )
        self._errors = (
            _Plot(server, tab, 3, "Position, cm", "frame", {"error": "#f87171", "3 sigma": "#9ca3af"})
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
        self._times.draw(*map(np.asarray, times))
        self._psnr.draw(np.asarray(history.steps), np.asarray(history.psnr))
        if self._errors is not None:
            self._errors.draw(frames, 100 * errors_m, 100 * bounds_m)


class _Plot:
    """Lines over one axis; made when there is something to draw, for uPlot makes no use of an empty start.

    Args:
        server: the viser server.
        tab: where it is.
        order: its place there.
        title: with the unit.
        along: name of the axis across.
        lines: colours by the names of the lines.
        log: whether the axis upwards is logarithmic.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        tab: viser.GuiTabHandle,
        order: int,
        title: str,
        along: str,
        lines: dict[str, str],
        *,
        log: bool = False,
    ) -> None:
        self._server, self._tab, self._order, self._title = server, tab, order, title
        self._along, self._lines, self._log = along, lines, log
        self._handle: viser.GuiUplotHandle | None = None

    def draw(self, *columns: Shaped[np.ndarray, " n"]) -> None:
        """Draw the lines anew.

        Args:
            columns: places across, and values of each line; nothing is drawn of a single place.
        """
        if len(columns[0]) < 2:
            return
        step = 1 + len(columns[0]) // _MOST_POINTS
        data = tuple(column[::step].astype(np.float64) for column in columns)
        if self._handle is None:
            with self._tab:
                self._handle = self._made(data)
        else:
            self._handle.data = data

    def _made(self, data: tuple[np.ndarray, ...]) -> viser.GuiUplotHandle:
        grid, ticks = uplot.Axis_Grid(stroke=_GRID, width=1), uplot.Axis_Ticks(stroke=_GRID, size=4)
        across, up = (
            uplot.Axis(stroke=_TEXT, grid=grid, ticks=ticks, size=size, font=_FONT) for size in (26, 44)
        )
        series = (uplot.Series(label=name, stroke=colour, width=1.5) for name, colour in self._lines.items())
        return self._server.gui.add_uplot(
            data,
            (uplot.Series(label=self._along), *series),
            title=self._title,
            scales={"x": uplot.Scale(time=False), "y": uplot.Scale(distr=3 if self._log else 1)},
            axes=(across, up),
            legend=uplot.Legend(show=len(self._lines) > 1),
            height=120,
            order=_AFTER_PICTURE + self._order,
        )
