"""The trajectory and the rendered views of a run, as sections of the page."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import Recording
from sfgs_jax.evaluation._run_folder import read_json
from sfgs_jax.evaluation.report._compared_views import ComparedView
from sfgs_jax.evaluation.report._html import section, table
from sfgs_jax.evaluation.report._pictures import (
    LARGEST_ERROR,
    depth_picture,
    depth_scale,
    error_picture,
    rgb_picture,
)
from sfgs_jax.evaluation.report._plots import plot_depth_correction, plot_errors, plot_paths, plot_quality
from sfgs_jax.evaluation.trajectory import ate
from sfgs_jax.geometry import Trajectory, read_covariances, read_tum

SEEN_AT = 2.0
"""Depth at which the correction of depth is shown, metres."""
_TIMES = {
    "depth_delay": "Depth after colour",
    "colour_readout": "Read-out of colour",
    "depth_readout": "Read-out of depth",
}


def trajectory_section(run_dir: Path, recording: Recording) -> str:
    """Plots of the path, and of its error over time if there is ground truth.

    Args:
        run_dir: folder that a run wrote.
        recording: the recording of the run.
    """
    estimate, keyframes = read_tum(run_dir / "trajectory.txt"), _keyframes(run_dir)
    if not len(estimate):
        return section("Trajectory", "<p>No frame has a pose.</p>")
    truth, absolute = None, None
    if recording.ground_truth is not None:
        try:
            absolute = ate(estimate, recording.ground_truth)
            truth = _in_world_of(absolute.T_reference_estimate, recording.ground_truth, estimate)
        except InputError:
            pass  # the section of missing figures gives the reason
    deviations = _deviations(run_dir)
    errors = plot_errors(absolute, deviations) if absolute or deviations else ""
    return section("Trajectory", plot_paths(estimate, keyframes, truth) + errors)


def _deviations(run_dir: Path) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]] | None:
    """Time stamps and standard deviations of the positions, metres; None if the run gave none."""
    path = run_dir / "trajectory_covariance.txt"
    if not path.exists():
        return None
    timestamps, covariances = read_covariances(path)
    return timestamps, np.sqrt(np.trace(covariances[:, :3, :3], axis1=1, axis2=2))


def sensors_section(run_dir: Path) -> str:
    """What the run has found about the camera, with standard deviations; empty if it estimated nothing.

    Args:
        run_dir: folder that a run wrote.
    """
    path = run_dir / "sensors.json"
    if not path.exists():
        return ""
    found, rows = read_json(path), []
    for name, title in _TIMES.items() if "times_s" in found else ():
        value, sigma = 1e3 * found["times_s"][name], 1e3 * found["times_sigma_s"][name]
        rows.append((title, f"{value:.1f} ± {sigma:.1f} ms"))
    picture = ""
    if "depth_offsets_per_m" in found:
        off = 1e3 * SEEN_AT**2 * np.asarray(found["depth_offsets_per_m"])
        sigma = 1e3 * SEEN_AT**2 * float(np.mean(found["depth_offsets_sigma_per_m"]))
        rows.append(
            (f"Correction of depth at {SEEN_AT:g} m", f"{off.min():.0f} to {off.max():.0f} ± {sigma:.0f} mm")
        )
        picture = plot_depth_correction(off)
    if "T_colour_depth_tangent" in found:
        rows += _extrinsic_rows(found["T_colour_depth_tangent"], found["T_colour_depth_sigma"])
    return section("Camera", table(("", "estimated"), rows, numbers=True) + picture)


def _extrinsic_rows(tangent: list[float], sigma: list[float]) -> list[tuple[str, str]]:
    """What the registration of depth to colour leaves out, axis by axis, with mean standard deviations."""
    (*shift, x, y, z), (*shift_sigma, a, b, c) = tangent, sigma
    degrees = 180 / np.pi
    return [
        ("Depth camera beside the colour camera (x, y, z)", _axes(shift, shift_sigma, 1e3, 1) + " mm"),
        ("Depth camera turned against it (x, y, z)", _axes([x, y, z], [a, b, c], degrees, 2) + " °"),
    ]


def _axes(values: list[float], sigmas: list[float], unit: float, digits: int) -> str:
    numbers = ", ".join(f"{unit * value:.{digits}f}" for value in values)
    return f"{numbers} ± {unit * float(np.mean(sigmas)):.{digits}f}"


def _keyframes(run_dir: Path) -> Trajectory:
    path = run_dir / "keyframes.txt"
    return read_tum(path) if path.exists() else Trajectory(np.zeros(0), np.zeros((0, 4, 4)))


def _in_world_of(
    T_truth_estimate: Float[np.ndarray, "4 4"], truth: Trajectory, estimate: Trajectory
) -> Trajectory:
    """The ground truth in the estimate's world frame, over the estimate's time only."""
    times = estimate.timestamps
    during = (truth.timestamps >= times.min() - 0.1) & (truth.timestamps <= times.max() + 0.1)
    return Trajectory(truth.timestamps[during], np.linalg.inv(T_truth_estimate) @ truth.poses[during])


def worst_frames(frames: dict[str, Float[np.ndarray, " n"]], count: int) -> list[int]:
    """Positions in the recording of the frames with the lowest PSNR by `gs_icp`.

    Args:
        frames: columns of `frames.csv`.
        count: most frames.
    """
    if not frames:
        return []
    quality = frames["psnr_gs_icp"]
    known = np.flatnonzero(np.isfinite(quality))
    return frames["index"][known[np.argsort(quality[known])[:count]]].astype(int).tolist()


def quality_section(frames: dict[str, Float[np.ndarray, " n"]]) -> str:
    """PSNR of the frames over time; empty if none was scored.

    Args:
        frames: columns of `frames.csv`.
    """
    if not frames or not np.isfinite(frames["psnr_gs_icp"]).any():
        return ""
    return section("Quality over time", plot_quality(frames))


def views_section(views: list[ComparedView]) -> str:
    """Recorded and rendered pictures, a row a view; empty without views."""
    if not views:
        return ""
    known = np.concatenate([view.depth[view.depth > 0] for view in views])
    near, far = np.percentile(known, [1, 99]).tolist() if len(known) else (0.0, 1.0)
    rows = []
    for view in views:
        pictures = (
            ("recorded", rgb_picture(view.rgb)),
            ("rendered", rgb_picture(view.rendered_rgb)),
            ("difference", error_picture(view.rendered_rgb - view.rgb)),
            ("recorded depth", depth_picture(view.depth, near, far)),
            ("rendered depth", depth_picture(view.rendered_depth, near, far)),
        )
        figures = "".join(
            f"<figure><img src='{data}' alt='{name}, frame {view.index}'>"
            f"<figcaption>{name}</figcaption></figure>"
            for name, data in pictures
        )
        tags = ("keyframe",) * view.keyframe + ("one of the worst",) * view.worst
        tag = "".join(f"<span class='tag'>{name}</span>" for name in tags)
        rows.append(
            f"<div class='view'><div class='caption'><b>Frame {view.index}</b>"
            f"<span class='soft'>{view.time_s:.1f} s</span><span>PSNR {view.psnr:.2f} dB</span>{tag}</div>"
            f"<div class='images'>{figures}</div></div>"
        )
    scale = (
        f"<div class='scale'>{near:.1f} m <img src='{depth_scale()}' alt='depth scale'> {far:.1f} m"
        "<span>black: no depth</span>"
        f"<span>difference: white is {LARGEST_ERROR:g} of the range of colours</span></div>"
    )
    return section("Rendered beside recorded", "".join(rows) + scale)
