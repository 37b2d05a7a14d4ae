"""Does depth lie on its colour: not mirrored or turned, not beside it, and of the same instant?

All three are told by outlines in depth, which lie on edges in colour only where the images belong together.
No unit of depth, intrinsics or poses are needed.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from sfgs_jax.evaluation.recording_check._finding import Finding
from sfgs_jax.evaluation.recording_check._sample import RecordingSample
from sfgs_jax.sensors import Outlines, outline_agreement

_FARTHEST = 15
"""Most frames that depth is tried earlier or later."""
_CLEAR = 0.2
"""Least agreement that counts as one, and least gain that counts as better."""
_SIGMAS = 3.0

Points = Float[np.ndarray, "n 2"] | Int[np.ndarray, "n 2"]
Transform = Callable[[Points], Points]

AS_IT_IS = "as it is"

LAYOUTS: dict[str, Transform] = {
    AS_IT_IS: lambda p: p,
    "mirrored left to right": lambda p: np.c_[1 - p[:, 0], p[:, 1]],
    "mirrored top to bottom": lambda p: np.c_[p[:, 0], 1 - p[:, 1]],
    "turned by 180 degrees": lambda p: 1 - p,
    "transposed": lambda p: p[:, ::-1],
    "turned by 90 degrees clockwise": lambda p: np.c_[p[:, 1], 1 - p[:, 0]],
    "turned by 90 degrees anticlockwise": lambda p: np.c_[1 - p[:, 1], p[:, 0]],
    "transposed on the other diagonal": lambda p: 1 - p[:, ::-1],
}
"""For depth with a fault, how its pixels (u, v), from 0 to 1, get to where they belong."""


def placed(depth: Float[np.ndarray, "h w"], layout: str) -> Float[np.ndarray, "h w"]:
    """Depth with its pixels where they belong.

    Args:
        depth: with the fault.
        layout: one of `LAYOUTS`.
    """
    if layout == AS_IT_IS:
        return depth
    size = np.array(depth.shape[::-1]) - 1
    rows, columns = np.indices(depth.shape)
    target = np.rint(LAYOUTS[layout](np.c_[columns.ravel(), rows.ravel()] / size) * size).astype(np.int32)
    image = np.zeros_like(depth)
    image[target[:, 1], target[:, 0]] = depth.ravel()
    return image


@dataclass(frozen=True)
class DepthPlace:
    """How depth lies in its colour.

    Attributes:
        layout: the one of `LAYOUTS` by which it fits.
        lag: number of frames by which depth comes late; negative if it comes early.
        findings: on the layout, the registration and the synchronisation.
    """

    layout: str
    lag: int
    findings: tuple[Finding, ...]

    @property
    def in_place(self) -> bool:
        """Whether nothing was found wrong."""
        return all(finding.severity != "warning" for finding in self.findings)


def check_depth_place(sample: RecordingSample) -> DepthPlace:
    """Find layout, lag and registration of depth.

    Args:
        sample: of the recording.
    """
    tables = {name: _by_lag(sample, name) for name in LAYOUTS}
    best = max(tables, key=lambda name: tables[name].peak)
    surely = tables[best].clear and tables[best].peak > 2 * max(tables[AS_IT_IS].peak, 0.05)
    layout = best if surely else AS_IT_IS
    table = tables[layout]
    lag = _lag_finding(table)
    late = table.lag if lag.severity == "warning" else 0
    registration = _registration_finding(sample, table, in_place=layout == AS_IT_IS and not late)
    return DepthPlace(layout, late, (_layout_finding(layout, tables), lag, registration))


@dataclass(frozen=True)
class _LagTable:
    """Agreement of depth and colour over the frames that depth is late.

    Attributes:
        lags: frames.
        means: agreement at each lag; NaN where nothing tells.
        against: of each colour frame, agreement at the best lag less that at 0.
        spread: standard error of the best mean, over windows.
        outlined: share of the frames with outlines in depth.
    """

    lags: Int[np.ndarray, " l"]
    means: Float[np.ndarray, " l"]
    against: Float[np.ndarray, " n"]
    spread: float
    outlined: float

    @property
    def peak(self) -> float:
        return float(np.nanmax(self.means)) if np.isfinite(self.means).any() else 0.0

    @property
    def lag(self) -> int:
        return int(self.lags[np.nanargmax(self.means)]) if np.isfinite(self.means).any() else 0

    @property
    def now(self) -> float:
        return float(self.means[self.lags == 0][0])

    @property
    def clear(self) -> bool:
        return self.peak > max(_CLEAR, _SIGMAS * self.spread)

    @property
    def refined_lag(self) -> float:
        """Centre of mass of the peak."""
        at = np.abs(self.lags - self.lag) <= 2
        weights = np.maximum(np.nan_to_num(self.means[at] - np.nanmedian(self.means)), 0)
        return float(weights @ self.lags[at] / max(weights.sum(), 1e-9))

    @property
    def contrast(self) -> float:
        """Share of the peak that is lost within five frames, 0 for a camera that stands still."""
        near = (np.abs(self.lags - self.lag) <= 5) & np.isfinite(self.means)
        return 1 - float(np.min(self.means[near])) / max(self.peak, 1e-9)


def _by_lag(sample: RecordingSample, layout: str) -> _LagTable:
    size = np.array(sample.shape[::-1]) - 1
    table: dict[int, list[float]] = {lag: [] for lag in range(-_FARTHEST, _FARTHEST + 1)}
    by_frame: dict[tuple[int, int], float] = {}
    windows: dict[int, list[list[float]]] = {lag: [] for lag in table}
    outlined = []
    for window in sample.windows:
        for lag in table:
            windows[lag].append([])
        edges = (
            np.stack([frame.edges for frame in window])
            if window
            else np.zeros((0, *sample.shape, 2), np.int8)
        )
        for depth_frame in window:
            outlined.append(len(depth_frame.outlines.pixels) > 0)
            if not outlined[-1]:
                continue
            values = outline_agreement(edges, _turned(depth_frame.outlines, layout, size))[0]
            for colour_frame, value in zip(window, values.tolist(), strict=True):
                # Depth that belongs to an earlier colour image is late.
                lag = depth_frame.index - colour_frame.index
                if lag in table:
                    table[lag].append(value)
                    windows[lag][-1].append(value)
                    by_frame[colour_frame.index, lag] = value
    lags = np.array(sorted(table))
    enough = max(8, len(table[0]) // 8)
    means = np.array([np.mean(table[lag]) if len(table[lag]) >= enough else np.nan for lag in lags])
    best = int(lags[np.nanargmax(means)]) if np.isfinite(means).any() else 0
    against = [
        value - by_frame[index, 0]
        for (index, lag), value in by_frame.items()
        if lag == best and (index, 0) in by_frame
    ]
    per_window = [float(np.mean(values)) for values in windows[best] if values]
    spread = float(np.std(per_window) / np.sqrt(len(per_window))) if len(per_window) > 1 else 0.0
    return _LagTable(lags, means, np.asarray(against), spread, float(np.mean(outlined)))


def _turned(outlines: Outlines, layout: str, size: Int[np.ndarray, " 2"]) -> Outlines:
    """Outlines in the only place that they would have by a layout."""
    transform = LAYOUTS[layout]
    pixels = np.rint(transform(outlines.pixels / size) * size).astype(np.int32)
    across = transform(outlines.across) - transform(np.zeros((1, 2), np.float32))
    return Outlines(pixels[None], across[None])


def _layout_finding(layout: str, tables: dict[str, _LagTable]) -> Finding:
    table = tables[layout]
    evidence = {f"agreement {name}": found.peak for name, found in tables.items()}
    evidence["share of frames with outlines"] = table.outlined
    if layout != AS_IT_IS:
        return Finding(
            "depth layout",
            "warning",
            f"Depth is {layout} against colour: outlines agree with colour edges {table.peak:.2f} so, and "
            f"{tables[AS_IT_IS].peak:.2f} as the images are.",
            "Turn or mirror the depth images like the colour images when you save them.",
            evidence,
        )
    if table.clear:
        message = f"Outlines in depth lie on edges in colour ({table.peak:.2f}; 0 is chance)."
        return Finding("depth layout", "good", message, evidence=evidence)
    if table.outlined > 0.6 and table.peak < 0.5 * _CLEAR:
        return Finding(
            "depth layout",
            "warning",
            f"Outlines in depth lie nowhere near edges in colour ({table.peak:.2f}; at least {_CLEAR:g} is "
            "expected): the two images don't show the same view.",
            "Check that depth and colour come from one recording, and that depth is registered to colour.",
            evidence,
        )
    message = "It can't be told whether depth lies on its colour: the scene has too few outlines."
    return Finding("depth layout", "unknown", message, evidence=evidence)


def _lag_finding(table: _LagTable) -> Finding:
    lag, count = table.lag, len(table.against)
    evidence = {"frames late": table.refined_lag, "agreement": table.peak, "agreement as it is": table.now}
    if not table.clear:
        message = "It can't be told whether depth and colour are of one time: the scene has too few outlines."
        return Finding("synchronisation", "unknown", message, evidence=evidence)
    if table.contrast < 0.35:
        message = "It can't be told whether depth and colour are of one time: the camera hardly moves."
        return Finding("synchronisation", "unknown", message, evidence=evidence)
    # Frames of a window resemble each other; a fourth of them counts as independent.
    sigma = float(np.std(table.against)) / np.sqrt(max(1.0, count / 4)) if count else np.inf
    gain = float(np.mean(table.against)) if count else 0.0
    if lag and abs(table.refined_lag) > 0.7 and table.now < 0.8 * table.peak and gain > _SIGMAS * sigma:
        word, places = ("late", "after") if lag > 0 else ("early", "before")
        frames = "1 frame" if abs(lag) == 1 else f"{abs(lag)} frames"
        return Finding(
            "synchronisation",
            "warning",
            f"Depth comes {frames} {word} against colour; 0 is expected.",
            f"Pair each colour image with the depth image {frames} {places} its own.",
            evidence,
        )
    message = f"Depth and colour are of one time to a frame ({table.refined_lag:+.1f} frames)."
    return Finding("synchronisation", "good", message, evidence=evidence)


def _registration_finding(sample: RecordingSample, table: _LagTable, *, in_place: bool) -> Finding:
    if not table.clear or not in_place:
        reason = "correct the faults named first" if table.clear else "the scene has too few outlines"
        message = f"It can't be told whether depth is registered to colour: {reason}."
        return Finding("registration", "unknown", message)
    best, zoom, shift, plain = _best_placement(sample)
    moved = float(np.hypot(*shift) + abs(zoom - 1) * np.hypot(*sample.shape) / 2) / sample.pixel
    evidence = {"zoom": zoom, "right px": float(shift[0]), "down px": float(shift[1]), "gain": best / plain}
    if best > 1.5 * plain and best > plain + _CLEAR and moved > 8:
        return Finding(
            "registration",
            "warning",
            f"Depth lies beside its colour: {zoom:.3g} times as large, {shift[0]:.0f} pixels to the right "
            f"and {shift[1]:.0f} down, it would fit {best / plain:.1f} times as well.",
            "Register depth to the colour camera when recording; resizing alone does not do it.",
            evidence,
        )
    return Finding("registration", "good", "Depth lies on its colour to a few pixels.", evidence=evidence)


def _best_placement(sample: RecordingSample) -> tuple[float, float, Float[np.ndarray, " 2"], float]:
    """Agreement at the best zoom and shift of depth, these two, and the agreement as it is."""
    frames = [frame for frame in sample.frames if len(frame.outlines.pixels)]
    frames = frames[:: max(1, len(frames) // 16)]
    outlines = [frame.outlines.every(max(1, len(frame.outlines.pixels) // 500)) for frame in frames]
    centre = (np.array(sample.shape[::-1]) - 1) / 2
    steps = np.rint(np.arange(-24, 25, 4) * max(sample.pixel, 0.25))
    shifts = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 1, 2)
    best, zoom, shift, plain = -np.inf, 1.0, np.zeros(2), 1e-3
    for tried in (0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.15):
        values = [
            outline_agreement(frame.edges[None], _moved(some, tried, shifts, centre))
            for frame, some in zip(frames, outlines, strict=True)
        ]
        # Far shifts may leave no outline in the image.
        means = np.mean(np.nan_to_num(values), axis=0)[:, 0]
        place = int(means.argmax())
        if means[place] > best:
            best, zoom, shift = float(means[place]), tried, shifts[place, 0]
        if tried == 1:
            plain = max(plain, float(means[len(means) // 2]))
    return best, zoom, shift, plain


def _moved(
    outlines: Outlines, zoom: float, shifts: Float[np.ndarray, "s 1 2"], centre: Float[np.ndarray, " 2"]
) -> Outlines:
    """Outlines in each of the places that they would have by a zoom and some shifts."""
    pixels = np.rint((outlines.pixels - centre) * zoom + centre + shifts).astype(np.int32)
    return Outlines(pixels, np.broadcast_to(outlines.across, pixels.shape))
