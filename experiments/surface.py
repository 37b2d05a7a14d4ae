"""Geometry of a run on a synthetic place: its mesh against the place's own triangles.

    sfgs-jax run synthetic:frames=60 --out RUN
    sfgs-jax export RUN RUN/surface.ply --mesh
    python -m experiments.surface RUN RUN/surface.ply

The reference is cut down to what the frames show. The mesh is moved by the first frame's pose alone, so
errors of the trajectory count.
"""

import argparse
from pathlib import Path

import numpy as np
import trimesh

from sfgs_jax.cli import read_config
from sfgs_jax.datasets import SyntheticRecording
from sfgs_jax.evaluation import posed_frames, sample_triangles, seen_points, surface_figures

FOUND, REFERENCE = 1_000_000, 4_000_000
"""Points on the mesh, and on all triangles of the place."""


def shown_reference(recording: SyntheticRecording, every: int) -> np.ndarray:
    """Points of the place's triangles that some frame shows."""
    triangles = np.asarray(recording.scene.triangles, np.float64)
    corners = np.arange(3 * len(triangles)).reshape(-1, 3)
    points = sample_triangles(triangles.reshape(-1, 3), corners, REFERENCE)
    shown = np.zeros(len(points), bool)
    for index in range(0, len(recording), every):
        depth = np.asarray(recording[index].depth)
        shown |= seen_points(points, depth, recording.camera, recording.ground_truth.poses[index])
    return points[shown]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("run", type=Path, help="folder of the run")
    parser.add_argument("mesh", type=Path, help="PLY mesh or point cloud in the axes of the run's map")
    parser.add_argument("--every", type=int, default=5, help="cut the reference down by every n-th frame")
    options = parser.parse_args()
    recording = SyntheticRecording.parse(read_config(options.run / "config.json").source)
    posed = posed_frames(options.run, recording)
    T_truth_run = recording.ground_truth.poses[posed.indices[0]] @ np.linalg.inv(posed.poses[0])
    mesh = trimesh.load(options.mesh, process=False)
    if isinstance(mesh, trimesh.PointCloud):
        found, area = np.asarray(mesh.vertices, np.float64), "points"
    else:
        assert isinstance(mesh, trimesh.Trimesh)
        found = sample_triangles(np.asarray(mesh.vertices), np.asarray(mesh.faces), FOUND)
        area = f"{mesh.area:.1f} m²"
    found = found @ T_truth_run[:3, :3].T + T_truth_run[:3, 3]
    reference = shown_reference(recording, options.every)
    figures = surface_figures(found, reference)
    print("| surface | points found / reference | accuracy cm | completeness cm | precision | recall | F1 |")
    print("|---|---|---|---|---|---|---|")
    print(
        f"| {area} | {len(found)} / {len(reference)} | {100 * figures.accuracy_m:.2f} | "
        f"{100 * figures.completeness_m:.2f} | {figures.precision:.4f} | {figures.recall:.4f} | "
        f"{figures.f1:.4f} |"
    )
    print(f"Within {100 * figures.threshold_m:g} cm.")


if __name__ == "__main__":
    main()
