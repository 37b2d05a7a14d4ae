"""The figures of a run as cards and tables, from its `metrics.json`."""

from dataclasses import dataclass
from html import escape
from typing import Any

from sfgs_jax.evaluation.images import PROTOCOLS
from sfgs_jax.evaluation.report._html import foldable_values, section, table

_PROTOCOL_NOTES = {
    "all": "every pixel of every frame",
    "depth": "the pixels with input depth of every frame",
    "gs_icp": "every frame; pixels without input depth are zero in both images (GS-ICP-SLAM)",
    "gs_icp_exposure": "the same after gain and offset of each frame were fitted to the recorded image",
    "gs_icp_raw": "gs_icp of the map alone, without the exposures that the run has estimated",
    "splatam": "the first and every fifth frame, masked the same way (SplaTAM)",
    "views": "every pixel of the frames that were used for mapping",
    "held_out": "every pixel of every eighth frame, which no run uses for mapping",
}


@dataclass(frozen=True)
class _Headline:
    """A figure at the top of the page: its path of keys in the metrics, and its form."""

    label: str
    keys: tuple[str, ...]
    unit: str
    digits: int
    factor: float = 1.0
    note: str = ""


_HEADLINES = (
    _Headline("ATE RMSE", ("ate", "rmse_m"), "cm", 2, factor=100.0, note="over all frames"),
    _Headline("PSNR", ("psnr", "all"), "dB", 2, note="every pixel"),
    _Headline("PSNR gs_icp", ("psnr", "gs_icp"), "dB", 2, note="pixels without depth are zero in both"),
    _Headline("SSIM", ("ssim", "all"), "", 3, note="every pixel"),
    _Headline("LPIPS", ("lpips_squeeze", "splatam"), "", 3, note="SqueezeNet, lower is better"),
    _Headline("Frames tracked", ("frames", "tracked"), "", 0),
    _Headline("Speed", ("fps", "frames"), "frames/s", 1, note="after the first, refinement left out"),
    _Headline("Gaussians", ("map", "gaussians"), "", 0),
    _Headline("Peak memory", ("memory", "peak_mb"), "MB", 0),
)


def _get(metrics: dict[str, Any], *keys: str) -> Any:
    """The entry at a path of keys; None without one."""
    value: Any = metrics
    for key in keys:
        value = value.get(key) if isinstance(value, dict) else None
    return value


def cards(metrics: dict[str, Any]) -> str:
    """The headline figures as cards."""
    found = []
    for item in _HEADLINES:
        value = _get(metrics, *item.keys)
        if value is None:
            continue
        note = item.note
        if item.keys == ("frames", "tracked"):
            note = f"of {_get(metrics, 'frames', 'total')}, {_get(metrics, 'frames', 'keyframes')} keyframes"
        number = f"{value * item.factor:,.{item.digits}f}"
        found.append(
            f"<div class='card'><div class='label'>{item.label}</div>"
            f"<div class='value'>{number}<span class='unit'>{item.unit}</span></div>"
            f"<div class='note'>{escape(note)}</div></div>"
        )
    return f"<div class='cards'>{''.join(found)}</div>"


def missing_figures(metrics: dict[str, Any]) -> str:
    """The metrics that are not available, with the reasons; empty if there are none."""
    reasons = _get(metrics, "unavailable")
    if not reasons:
        return ""
    rows = [(f"<code>{escape(name)}</code>", escape(reason)) for name, reason in reasons.items()]
    return section("Not available", table(("metric", "why"), rows), css="missing")


def image_table(metrics: dict[str, Any]) -> str:
    """Image metrics by protocol."""
    rows = []
    for name in PROTOCOLS:
        cells = [
            f"{value:.{digits}f}" if (value := _get(metrics, metric, name)) is not None else "–"
            for metric, digits in (("psnr", 2), ("ssim", 3), ("lpips_squeeze", 3))
        ]
        note = f"<code>{name}</code><br><span class='soft small'>{_PROTOCOL_NOTES[name]}</span>"
        rows.append((note, *cells, str(_get(metrics, "evaluated", "frames", name) or "–")))
    every = _get(metrics, "evaluated", "every") or 1
    notes = []
    if every > 1:
        notes.append(f"Image metrics were computed on one frame in {every}.")
    if lpips_frames := _get(metrics, "evaluated", "lpips_frames"):
        notes.append(f"LPIPS (SqueezeNet) was computed on {lpips_frames} frames.")
    figures = table(("protocol", "PSNR (dB)", "SSIM", "LPIPS", "frames"), rows, numbers=True)
    return section("Image quality", figures + f"<p class='soft small'>{' '.join(notes)}</p>")


def trajectory_table(metrics: dict[str, Any]) -> str:
    """Errors of the trajectory."""
    lines = (
        ("ATE RMSE", ("ate", "rmse_m"), 100, "cm"),
        ("ATE mean (printed as “RMSE” by some papers)", ("ate", "mean_m"), 100, "cm"),
        ("ATE median", ("ate", "median_m"), 100, "cm"),
        ("ATE maximum", ("ate", "max_m"), 100, "cm"),
        ("RPE translation, frame to frame", ("rpe", "trans_m"), 100, "cm"),
        ("RPE rotation, frame to frame", ("rpe", "rot_deg"), 1, "°"),
        ("NEES of the covariances (6 is right)", ("nees", "mean"), 1, ""),
        ("Poses within three standard deviations", ("nees", "within_3_sigma"), 100, "%"),
    )
    rows = [
        (label, f"{value * factor:.2f} {unit}")
        for label, keys, factor, unit in lines
        if (value := _get(metrics, *keys)) is not None
    ]
    if not rows:
        return section("Trajectory error", "<p class='soft'>Not available.</p>")
    pairs = _get(metrics, "ate", "num_pairs")
    note = f"<p class='soft small'>{pairs} poses compared, after rigid alignment without scale.</p>"
    return section("Trajectory error", table(("error", ""), rows, numbers=True) + note)


def stage_table(metrics: dict[str, Any]) -> str:
    """Times of the stages, the longest first; empty if the run holds none."""
    stages = _get(metrics, "stages")
    if not stages:
        return ""
    longest = max(stage.get("median_ms", 0) for stage in stages.values()) or 1
    rows = []
    for name, stage in sorted(stages.items(), key=lambda item: -item[1].get("median_ms", 0)):
        share = 100 * stage.get("median_ms", 0) / longest
        rows.append(
            (
                escape(name),
                f"<span class='bar' style='width:{share:.1f}%'></span>",
                *(_milliseconds(stage.get(key)) for key in ("median_ms", "p95_ms")),
                "–" if "total_s" not in stage else f"{stage['total_s']:.1f}",
                str(stage.get("count", "–")),
            )
        )
    head = ("stage", "", "median (ms)", "95 % (ms)", "total (s)", "times")
    return section("Time per stage", table(head, rows, numbers=True, bars=True))


def _milliseconds(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def other_figures(metrics: dict[str, Any]) -> str:
    """The figures that no other section shows."""
    shown = {"ate", "rpe", "nees", "psnr", "ssim", "lpips_squeeze", "evaluated", "unavailable", "stages"}
    rest = {key: value for key, value in metrics.items() if key not in shown}
    return foldable_values("Counts, memory and versions", rest, opened=True)
