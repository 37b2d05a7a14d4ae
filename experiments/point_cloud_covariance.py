"""Do the covariances of registered point clouds cover the errors? Pairs of clouds against exact poses.

    python -m experiments.point_cloud_covariance [--recordings room hospital] [--pairs 36]

Depth images with exact poses become point clouds without order, like PLY files. Pairs of them, some frames
apart, are aligned from the identity. The square is e' C^-1 e of the motion's tangent, 6 on average if the
covariances C are right. Pairs that are not called converged, or that leave a direction free, are not counted.
Neither are pairs that ended elsewhere, more than two voxels off: no covariance speaks of those.
"""

import argparse
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from experiments.matching_tables import print_table
from experiments.recordings import DATA
from sfgs_jax.datasets import Recording, open_recording
from sfgs_jax.geometry import se3
from sfgs_jax.gicp import align, prepare_points

RECORDINGS = {
    "room": "synthetic:width=320,height=240",
    "hospital": str(DATA / "tartanair" / "hospital_clip"),
}
NOISES = (0.0, 0.001, 0.0015)
"""Deviations of depth at 1 m, metres; they grow with its square."""
MOST_POINTS = 130_000
FARTHEST = 20.0
COLUMNS = ("recording", "noise at 1 m", "pairs", "elsewhere", "mean square", "median", "error mm", "sigma mm")


class Pair(NamedTuple):
    """A pair of clouds: the tangent of the error, its covariance, and the size of the voxels."""

    error: Float[np.ndarray, "6"]
    covariance: Float[np.ndarray, "6 6"]
    voxel_size: float

    @property
    def square(self) -> float:
        """Normalised square of the error."""
        return float(self.error @ np.linalg.solve(self.covariance, self.error))


def points_of(
    recording: Recording, number: int, noise: float, rng: np.random.Generator
) -> Float[np.ndarray, "n 3"]:
    """Points of a frame in its camera's coordinates, in no order."""
    camera, depth = recording.camera, np.asarray(recording[number].depth, np.float64)
    v, u = np.nonzero((depth > 0) & (depth < FARTHEST))
    z = depth[v, u]
    z = z + noise * z**2 * rng.normal(size=len(z))
    x, y = (u - float(camera.cx)) / float(camera.fx) * z, (v - float(camera.cy)) / float(camera.fy) * z
    return rng.permutation(np.stack([x, y, z], axis=1))[:MOST_POINTS]


def pairs_of(recording: Recording, count: int, gap: int, noise: float) -> list[Pair]:
    """Registrations of pairs of frames spread over a recording, those that converged."""
    rng, truth, found = np.random.default_rng(0), recording.ground_truth, []
    assert truth is not None
    for first in np.linspace(0, len(recording) - 1 - gap, count).astype(int):
        target, source = (
            prepare_points(points_of(recording, n, noise, rng)) for n in (int(first), int(first) + gap)
        )
        result = align(source, target, np.eye(4))
        if not result.converged or np.any(result.free):
            continue
        known = np.linalg.inv(truth.poses[first]) @ truth.poses[first + gap]
        T = np.asarray(se3.matrix(result.T_target_source), np.float64)
        error = se3.logs_of((np.linalg.inv(known) @ T)[None])[0]
        covariance = np.asarray(result.covariance, np.float64)
        found.append(Pair(error, covariance, float(source.levels[0].voxel_size)))
    return found


def row(name: str, noise: float, pairs: list[Pair]) -> tuple[str, ...]:
    """A row of the table."""
    good = [pair for pair in pairs if np.linalg.norm(pair.error[:3]) < 2 * pair.voxel_size]
    squares = [pair.square for pair in good]
    error = np.sqrt(np.mean([np.sum(pair.error[:3] ** 2) for pair in good]))
    sigma = np.sqrt(np.mean([np.trace(pair.covariance[:3, :3]) for pair in good]))
    return (
        name,
        f"{1e3 * noise:.1f} mm",
        str(len(good)),
        str(len(pairs) - len(good)),
        f"{np.mean(squares):.1f}",
        f"{np.median(squares):.1f}",
        f"{1e3 * error:.2f}",
        f"{1e3 * sigma:.2f}",
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--recordings", nargs="+", default=["room", "hospital"], choices=list(RECORDINGS))
    parser.add_argument("--pairs", type=int, default=36)
    parser.add_argument("--gap", type=int, default=2, help="frames from one cloud of a pair to the other")
    parser.add_argument("--noises", nargs="+", type=float, default=NOISES)
    options = parser.parse_args()
    rows = []
    for name in options.recordings:
        recording = open_recording(RECORDINGS[name])
        for noise in options.noises:
            rows.append(row(name, noise, pairs_of(recording, options.pairs, options.gap, noise)))
    print_table("covariances of point clouds", COLUMNS, rows)


if __name__ == "__main__":
    main()
