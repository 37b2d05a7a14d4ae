"""The few lines that a run or an evaluation ends with."""

from pathlib import Path
from typing import Any


def summary(metrics: dict[str, Any], folder: Path) -> str:
    """The main figures of a run, and what can be done next.

    Args:
        metrics: content of `metrics.json`, evaluated or not.
        folder: the run's folder.
    """
    lines = [*_run_lines(metrics), *_evaluation_lines(metrics), f"results: {folder}"]
    if (folder / "report.html").is_file():
        lines.append(f"report: {folder / 'report.html'}")
    else:
        lines.append(f"metrics and report: sfgs-jax eval {folder}")
    return "\n".join([*lines, f"look at the map: sfgs-jax view {folder}"])


def _run_lines(metrics: dict[str, Any]) -> list[str]:
    """Counts and speed, as far as the run left them."""
    frames, speed = metrics.get("frames", {}), metrics.get("fps", {})
    lines = []
    if {"tracked", "total", "keyframes"} <= frames.keys():
        others = [f"{frames[kind]} {kind}" for kind in ("lost", "dropped", "skipped") if frames.get(kind)]
        parts = f"{frames['tracked']} of {frames['total']} frames tracked", *others
        line = ", ".join([*parts, f"{frames['keyframes']} keyframes"])
        gaussians = metrics.get("map", {}).get("gaussians")
        lines.append(line if gaussians is None else f"{line}, {gaussians} Gaussians")
    if elsewhere := frames.get("in_other_maps"):
        count = metrics["map"]["number"] - 1
        maps = "another map" if count == 1 else f"{count} other maps"
        lines.append(
            f"{elsewhere} frames are in {maps}: they share no place with the largest that was recognised "
            "(trajectory_2.txt, map_2.ply, and so on)"
        )
    # A run that was resumed after its last frame tracked none.
    if {"frames", "overall"} <= speed.keys() and speed["frames"] > 0:
        lines.append(
            f"{speed['frames']} frames/s after the first frame "
            f"({speed['overall']} with compilation and refinement)"
        )
    return lines


def _evaluation_lines(metrics: dict[str, Any]) -> list[str]:
    lines = []
    if "ate" in metrics:
        lines.append(f"ATE RMSE {100 * metrics['ate']['rmse_m']:.2f} cm")
    if "psnr" in metrics:
        lines.append(
            f"PSNR {metrics['psnr']['all']:.2f} dB, SSIM {metrics['ssim']['all']:.3f} over "
            f"{metrics['evaluated']['frames']['all']} frames, every pixel"
        )
    return lines + [f"no {name}: {reason}" for name, reason in metrics.get("unavailable", {}).items()]
