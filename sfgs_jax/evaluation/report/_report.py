"""report.html: a single page that shows a run, with everything it needs inside it."""

from html import escape
from importlib.resources import files
from pathlib import Path

import numpy as np

from sfgs_jax.arrays import checked, write_atomically
from sfgs_jax.datasets import Recording
from sfgs_jax.evaluation._run_folder import posed_frames, read_json
from sfgs_jax.evaluation.images import FRAMES_FILE, read_frames
from sfgs_jax.evaluation.report._compared_views import compared_views
from sfgs_jax.evaluation.report._headline_figures import (
    cards,
    image_table,
    missing_figures,
    other_figures,
    stage_table,
    trajectory_table,
)
from sfgs_jax.evaluation.report._html import foldable_values
from sfgs_jax.evaluation.report._sections import (
    quality_section,
    sensors_section,
    trajectory_section,
    views_section,
    worst_frames,
)
from sfgs_jax.splatting import load_ply

_NUM_WORST = 2
"""Worst frames that are shown."""


@checked
def write_report(run_dir: Path, recording: Recording, *, num_views: int = 6) -> Path:
    """Write `report.html` into a run's folder: a single file without any external link.

    Figures come from `metrics.json`, so evaluate the run first.

    Args:
        run_dir: folder that a run wrote.
        recording: the recording of the run.
        num_views: number of evenly spaced views to show beside the recorded ones; the worst come besides.

    Returns:
        The page's path.

    Raises:
        InputError: a file of the run is missing, damaged, or belongs to another recording.
    """
    metrics, config = read_json(run_dir / "metrics.json"), read_json(run_dir / "config.json")
    posed = posed_frames(run_dir, recording)
    frames = read_frames(run_dir / FRAMES_FILE)
    worst = worst_frames(frames, _NUM_WORST)
    views = compared_views(load_ply(run_dir / "map.ply"), recording, posed, num_views, worst)
    body = [
        _header(recording),
        cards(metrics),
        missing_figures(metrics),
        trajectory_section(run_dir, recording),
        quality_section(frames),
        views_section(views),
        "<div class='columns'>" + image_table(metrics) + trajectory_table(metrics) + "</div>",
        sensors_section(run_dir),
        stage_table(metrics),
        foldable_values("Configuration", config, opened=False),
        other_figures(metrics),
    ]
    style = files("sfgs_jax.evaluation.report").joinpath("report.css").read_text()
    page = (
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width, initial-scale=1'>"
        f"<title>{escape(recording.name)} · sfgs-jax</title><style>{style}</style></head><body><main>"
        + "".join(body)
        + "<footer>Written by sfgs-jax. The numbers are in metrics.json and frames.csv, the paths in "
        "trajectory.txt, the map in map.ply.</footer></main></body></html>\n"
    )
    path = run_dir / "report.html"
    write_atomically(path, page)
    return path


def _header(recording: Recording) -> str:
    height, width = recording.camera.shape
    duration = f"{float(np.ptp(recording.timestamps)):.1f} s" if len(recording) else "empty"
    return (
        f"<header><h1>{escape(recording.name)}</h1><p class='soft'>{escape(recording.dataset)} recording · "
        f"{len(recording)} frames of {width} × {height} · {duration}</p></header>"
    )
