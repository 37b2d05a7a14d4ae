"""Do the covariances cover the errors? Poses against exact truth, in their own standard deviations.

    python -m experiments.covariance [--recordings room ring kinect fr1_rpy] [--frames 300]
        [--sensors] [--extrinsic]

NEES is the normalised estimation error squared of a pose's tangent, e' C^-1 e, its mean over all frames. It
is 6 if the covariances C are right. A frame is within 3 sigma if its square is as likely as 3 standard
deviations of a number. All poses are relative to the first camera, the world frame of a run. The column
*then* has the pose as it was reported with its frame, and *at the end* that after the last adjustment. With
`--sensors` the times of the rows and the distortion of depth are estimated, with `--extrinsic` the place of
its camera too. The truth of the real recordings has errors of its own.
"""

import argparse
from dataclasses import replace

import numpy as np

from experiments.matching_tables import print_table
from experiments.recordings import SOURCES
from sfgs_jax.datasets import Recording, open_recording
from sfgs_jax.evaluation import Nees, ate, nees
from sfgs_jax.geometry import Trajectory, se3
from sfgs_jax.slam import SlamConfig, finish, follow, init

RECORDINGS = {
    "room": "synthetic:noise=1,frames={}",
    "another room": "synthetic:noise=2,seed=7,frames={}",
    "ring": "synthetic:noise=1,place=ring,frames={}",
    "twins": "synthetic:noise=1,place=twins,frames={}",
    "kinect": "synthetic:kinect=1,frames={}",
    **SOURCES,
}
COLUMNS = (
    "recording",
    "frames",
    "ATE cm",
    "NEES then",
    "within 3 sigma",
    "NEES at the end",
    "within 3 sigma",
    "error at the end mm",
    "sigma",
    "mrad",
    "sigma",
)


def cells(found: Nees) -> tuple[str, str]:
    """Mean of the squares, and share of the frames within three deviations."""
    return f"{found.mean:.1f}", f"{100 * found.share_within(3.0):.1f} %"


def sizes(found: Nees) -> tuple[str, ...]:
    """Root mean square errors and deviations, in millimetres and milliradians."""
    variances = np.einsum("nii->ni", found.covariances)
    squares = (
        values[:, part].sum(1).mean()
        for part in (slice(0, 3), slice(3, 6))
        for values in (found.errors**2, variances)
    )
    return tuple(f"{1e3 * np.sqrt(square):.1f}" for square in squares)


def row(name: str, recording: Recording, num_frames: int, config: SlamConfig) -> tuple[str, ...]:
    """A recording's row of the table."""
    truth, state = recording.ground_truth, init(recording.camera, config)
    assert truth is not None
    poses, covariances = [], []
    for number in range(min(num_frames, len(recording))):
        state, info, _ = follow(state, recording[number], number=number)
        if info.tracked:
            poses.append(np.asarray(se3.matrix(info.T_world_cam)))
            covariances.append(info.covariance)
    state = finish(state)
    found = state.trajectory
    then = nees(Trajectory(found.timestamps, np.stack(poses)), np.stack(covariances), truth)
    at_end = nees(found, state.covariances, truth)
    error = 100 * ate(found, truth).rmse_m
    return (name, str(len(found)), f"{error:.2f}", *cells(then), *cells(at_end), *sizes(at_end))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--recordings", nargs="+", default=list(RECORDINGS), choices=list(RECORDINGS))
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--sensors", action="store_true", help="estimate the model of the sensors")
    parser.add_argument("--extrinsic", action="store_true", help="and where depth's camera is")
    options = parser.parse_args()
    on = options.sensors or options.extrinsic
    tracking = replace(
        SlamConfig().tracking,
        estimate_timing=on,
        estimate_depth=on,
        estimate_extrinsic=options.extrinsic,
    )
    config = replace(SlamConfig(), tracking=tracking)
    rows = (
        row(name, open_recording(RECORDINGS[name].format(options.frames)), options.frames, config)
        for name in options.recordings
    )
    print_table(f"{'with' if on else 'without'} the model of the sensors", COLUMNS, rows)


if __name__ == "__main__":
    main()
