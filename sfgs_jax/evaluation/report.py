"""`report.html`: one page that shows a run, with everything it needs inside it."""

from collections.abc import Iterable
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from sfgs_jax.datasets import Recording
from sfgs_jax.evaluation.image_metrics import PROTOCOLS
from sfgs_jax.evaluation.pictures import depth_picture, depth_scale, rgb_picture
from sfgs_jax.evaluation.plots import plot_errors, plot_paths
from sfgs_jax.evaluation.run_folder import posed_frames, read_json
from sfgs_jax.evaluation.trajectory_metrics import ate
from sfgs_jax.evaluation.views import View, render_views
from sfgs_jax.geometry import InputError, Trajectory, read_tum, write_atomically
from sfgs_jax.splatting import load_ply

_PROTOCOL_NOTES = {
    "all": "every pixel of every frame",
    "gs_icp": "every frame; pixels without input depth are zero in both images (GS-ICP-SLAM)",
    "splatam": "the first and every fifth frame, masked the same way (SplaTAM)",
    "held_out": "every pixel of the frames that were not used for mapping",
}


def write_report(run_dir: Path, recording: Recording, *, num_views: int = 6) -> Path:
    """Write `report.html` into a run's folder: a single file without any external link.

    Figures come from `metrics.json`, so evaluate the run first.

    Args:
        run_dir: folder that a run wrote.
        recording: what the run was made on.
        num_views: how many rendered views to show beside the recorded ones.

    Returns:
        The page's path.

    Raises:
        InputError: a file of the run is missing, damaged, or belongs to another recording.
    """
    metrics, config = read_json(run_dir / "metrics.json"), read_json(run_dir / "config.json")
    posed = posed_frames(run_dir, recording)
    views = render_views(load_ply(run_dir / "map.ply"), recording, posed, num_views)
    height, width = recording.camera.shape
    body = [
        f"<header><h1>{escape(recording.name)}</h1><p class='soft'>{escape(recording.dataset)} recording · "
        f"{len(recording)} frames of {width} × {height} · {_duration(recording)}</p></header>",
        _cards(metrics),
        _missing(metrics),
        _trajectory(run_dir, recording),
        _views(views),
        "<div class='columns'>" + _image_table(metrics) + _trajectory_table(metrics) + "</div>",
        _stages(metrics),
        _settings("Configuration", config, opened=False),
        _settings("Counts, memory and versions", _rest(metrics), opened=True),
    ]
    page = (
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width, initial-scale=1'>"
        f"<title>{escape(recording.name)} · sfgs-jax</title><style>{_css()}</style></head><body><main>"
        + "".join(body)
        + "<footer>Written by sfgs-jax. The numbers are in metrics.json, the paths in trajectory.txt, "
        "the map in map.ply.</footer></main></body></html>\n"
    )
    path = run_dir / "report.html"
    write_atomically(path, page)
    return path


def _css() -> str:
    return files("sfgs_jax.evaluation").joinpath("report.css").read_text()


def _duration(recording: Recording) -> str:
    return f"{float(np.ptp(recording.timestamps)):.1f} s" if len(recording) else "empty"


@dataclass(frozen=True)
class _Headline:
    """A figure at the top of the page: where it is in the metrics, and how it reads."""

    label: str
    keys: tuple[str, ...]
    unit: str
    digits: int
    factor: float = 1.0
    note: str = ""


_HEADLINES = (
    _Headline("ATE RMSE", ("ate", "rmse_m"), "cm", 2, 100.0, "over all frames"),
    _Headline("PSNR", ("psnr", "all"), "dB", 2, note="every pixel"),
    _Headline("SSIM", ("ssim", "all"), "", 3, note="every pixel"),
    _Headline("LPIPS", ("lpips_squeeze", "splatam"), "", 3, note="SqueezeNet, lower is better"),
    _Headline("Frames tracked", ("frames", "tracked"), "", 0),
    _Headline("Speed", ("fps", "frames"), "frames/s", 1, note="after the first, refinement left out"),
    _Headline("Gaussians", ("map", "gaussians"), "", 0),
    _Headline("Peak memory", ("memory", "peak_mb"), "MB", 0),
)


def _get(metrics: dict[str, Any], *keys: str) -> Any:
    """The entry at a path of keys; None where there is none."""
    value: Any = metrics
    for key in keys:
        value = value.get(key) if isinstance(value, dict) else None
    return value


def _cards(metrics: dict[str, Any]) -> str:
    cards = []
    for item in _HEADLINES:
        value = _get(metrics, *item.keys)
        if value is None:
            continue
        note = item.note
        if item.keys == ("frames", "tracked"):
            note = f"of {_get(metrics, 'frames', 'total')}, {_get(metrics, 'frames', 'keyframes')} keyframes"
        number = f"{value * item.factor:,.{item.digits}f}"
        cards.append(
            f"<div class='card'><div class='label'>{item.label}</div>"
            f"<div class='value'>{number}<span class='unit'>{item.unit}</span></div>"
            f"<div class='note'>{escape(note)}</div></div>"
        )
    return f"<div class='cards'>{''.join(cards)}</div>"


def _missing(metrics: dict[str, Any]) -> str:
    reasons = _get(metrics, "unavailable")
    if not reasons:
        return ""
    rows = [(f"<code>{escape(name)}</code>", escape(reason)) for name, reason in reasons.items()]
    return _section("Not available", _table(("metric", "why"), rows), css="missing")


def _trajectory(run_dir: Path, recording: Recording) -> str:
    estimate, keyframes = read_tum(run_dir / "trajectory.txt"), _keyframes(run_dir)
    if not len(estimate):
        return _section("Trajectory", "<p>No frame has a pose.</p>")
    truth, errors = None, ""
    if recording.ground_truth is not None:
        try:
            absolute = ate(estimate, recording.ground_truth)
            truth = _in_world_of(absolute.T_reference_estimate, recording.ground_truth, estimate)
            errors = plot_errors(absolute)
        except InputError:
            pass  # the section on what is missing gives the reason
    return _section("Trajectory", plot_paths(estimate, keyframes, truth) + errors)


def _keyframes(run_dir: Path) -> Trajectory:
    path = run_dir / "keyframes.txt"
    return read_tum(path) if path.exists() else Trajectory(np.zeros(0), np.zeros((0, 4, 4)))


def _in_world_of(T_truth_estimate: np.ndarray, truth: Trajectory, estimate: Trajectory) -> Trajectory:
    """The ground truth in the estimate's world frame, over the estimate's time only."""
    times = estimate.timestamps
    during = (truth.timestamps >= times.min() - 0.1) & (truth.timestamps <= times.max() + 0.1)
    return Trajectory(truth.timestamps[during], np.linalg.inv(T_truth_estimate) @ truth.poses[during])


def _views(views: list[View]) -> str:
    if not views:
        return ""
    known = np.concatenate([view.depth[view.depth > 0] for view in views])
    near, far = np.percentile(known, [1, 99]).tolist() if len(known) else (0.0, 1.0)
    rows = []
    for view in views:
        pictures = (
            ("recorded", rgb_picture(view.rgb)),
            ("rendered", rgb_picture(view.rendered_rgb)),
            ("recorded depth", depth_picture(view.depth, near, far)),
            ("rendered depth", depth_picture(view.rendered_depth, near, far)),
        )
        figures = "".join(
            f"<figure><img src='{data}' alt='{name}, frame {view.index}'>"
            f"<figcaption>{name}</figcaption></figure>"
            for name, data in pictures
        )
        tag = "<span class='tag'>keyframe</span>" if view.keyframe else ""
        rows.append(
            f"<div class='view'><div class='caption'><b>Frame {view.index}</b>"
            f"<span class='soft'>{view.time_s:.1f} s</span><span>PSNR {view.psnr:.2f} dB</span>{tag}</div>"
            f"<div class='images'>{figures}</div></div>"
        )
    scale = (
        f"<div class='scale'>{near:.1f} m <img src='{depth_scale()}' alt='depth scale'> {far:.1f} m"
        "<span>black: no depth</span></div>"
    )
    return _section("Rendered beside recorded", "".join(rows) + scale)


def _image_table(metrics: dict[str, Any]) -> str:
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
    table = _table(("protocol", "PSNR (dB)", "SSIM", "LPIPS", "frames"), rows, numbers=True)
    return _section("Image quality", table + f"<p class='soft small'>{' '.join(notes)}</p>")


def _trajectory_table(metrics: dict[str, Any]) -> str:
    lines = (
        ("ATE RMSE", ("ate", "rmse_m"), 100, "cm"),
        ("ATE mean (printed as “RMSE” by some papers)", ("ate", "mean_m"), 100, "cm"),
        ("ATE median", ("ate", "median_m"), 100, "cm"),
        ("ATE maximum", ("ate", "max_m"), 100, "cm"),
        ("RPE translation, frame to frame", ("rpe", "trans_m"), 100, "cm"),
        ("RPE rotation, frame to frame", ("rpe", "rot_deg"), 1, "°"),
    )
    rows = [
        (label, f"{value * factor:.2f} {unit}")
        for label, keys, factor, unit in lines
        if (value := _get(metrics, *keys)) is not None
    ]
    if not rows:
        return _section("Trajectory error", "<p class='soft'>Not available.</p>")
    pairs = _get(metrics, "ate", "num_pairs")
    note = f"<p class='soft small'>{pairs} poses compared, after rigid alignment without scale.</p>"
    return _section("Trajectory error", _table(("error", ""), rows, numbers=True) + note)


def _stages(metrics: dict[str, Any]) -> str:
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
    return _section("Time per stage", _table(head, rows, numbers=True, bars=True))


def _milliseconds(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def _rest(metrics: dict[str, Any]) -> dict[str, Any]:
    """What no other section shows."""
    shown = {"ate", "rpe", "psnr", "ssim", "lpips_squeeze", "evaluated", "unavailable", "stages"}
    return {key: value for key, value in metrics.items() if key not in shown}


def _settings(title: str, values: dict[str, Any], *, opened: bool) -> str:
    if not values:
        return ""
    rows = [(f"<code>{escape(name)}</code>", f"<code>{escape(text)}</code>") for name, text in _flat(values)]
    state = " open" if opened else ""
    table = _table(("name", "value"), rows)
    return f"<section><details{state}><summary>{escape(title)}</summary>{table}</details></section>"


def _flat(values: dict[str, Any], prefix: str = "") -> Iterable[tuple[str, str]]:
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", str(value)


def _section(title: str, content: str, *, css: str = "") -> str:
    return f"<section class='{css}'><h2>{escape(title)}</h2>{content}</section>"


def _table(
    head: tuple[str, ...], rows: Iterable[tuple[str, ...]], *, numbers: bool = False, bars: bool = False
) -> str:
    """A table of cells that are HTML already; with `numbers`, all but the first column are aligned right."""
    classes = ["number" if numbers and column else "" for column in range(len(head))]
    if bars:
        classes[1] = "bars"
    body = "".join(
        "<tr>"
        + "".join(f"<td class='{css}'>{cell}</td>" for css, cell in zip(classes, row, strict=True))
        + "</tr>"
        for row in rows
    )
    top = "".join(f"<th class='{css}'>{cell}</th>" for css, cell in zip(classes, head, strict=True))
    return f"<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"
