"""Priors of the errors of depth: what each leaves of them, and whether its deviations say so.

    python -m experiments.depth_hypotheses [--starts 4] [--frames 120]

Rooms at 320x240 by cameras whose depth is exact, distorted by 3 mm at 2 m, or by 3 cm, and by none or an
extrinsic of 10 mm and 0.3 degrees. Each start has another room and another camera. One run serves all priors:
they read the same sum of what the registrations said. The first expects errors as large as the settings say.
The next two hold each error for as likely there as not, with distortions of one size or of two. The last is
the one in use: one camera in twenty is without. The squared error of the extrinsic is in standard deviations,
6 if the covariance is right.
"""

import argparse
from dataclasses import replace
from itertools import product
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from experiments.matching_tables import print_table
from experiments.sensors import millimetres
from sfgs_jax.datasets import KinectFaults, SyntheticRecording
from sfgs_jax.geometry import se3
from sfgs_jax.sensors import DEPTH_GRID, DepthCorrection
from sfgs_jax.slam import SlamConfig, finish, follow, init
from sfgs_jax.slam.state import DepthInformation, depth_estimate

BANDS = {"exact": 0.0, "3 mm": 0.003, "3 cm": 0.03}
EXTRINSICS = {"none": (0.0, 0.0), "10 mm": (0.01, np.radians(0.3))}
PRIORS: dict[str, dict[str, Any]] = {
    "the settings'": {"absent": 0.0, "sizes": (1.0,)},
    "as likely as not, one size": {"absent": 0.5, "sizes": (1.0,)},
    "as likely as not": {"absent": 0.5},
    "**absent in one of twenty**": {},
}
COLUMNS = (
    "distorted by",
    "extrinsic",
    "prior",
    "offsets off by mm",
    "σ",
    "extrinsic off by mm",
    "σ",
    "NEES",
    "most",
)
CONFIG = replace(
    SlamConfig(), tracking=replace(SlamConfig().tracking, estimate_depth=True, estimate_extrinsic=True)
)


def heard(recording: SyntheticRecording) -> DepthInformation:
    """Sum of what the registrations of a run said.

    Args:
        recording: any room.
    """
    state = init(recording.camera, CONFIG)
    for number in range(len(recording)):
        state = follow(state, recording[number], number=number).state
    return finish(state).graph.depth


def errors(depth: DepthInformation, recording: SyntheticRecording, prior: dict) -> Float[np.ndarray, "5"]:
    """Errors of offsets and extrinsic in mm, each with its deviation, and the squared error of the latter.

    Args:
        depth: what registrations said.
        recording: with the truth.
        prior: keywords of `depth_estimate`.
    """
    mean, covariance = depth_estimate(depth, CONFIG.tracking, **prior)
    correction = DepthCorrection(jnp.asarray(mean[:-6].reshape(DEPTH_GRID), jnp.float32))
    found = np.asarray(correction.image(recording.camera))
    truth, variances = se3.logs_of(recording.T_colour_depth[None])[0], np.diag(covariance)
    off = mean[-6:] - truth
    return np.asarray(
        [
            millimetres(found - recording.inverse_depth_offsets),
            millimetres(np.sqrt(variances[:-6])),
            1e3 * np.linalg.norm(off[:3]),
            1e3 * np.sqrt(variances[-6:-3].sum()),
            off @ np.linalg.solve(covariance[-6:, -6:], off),
        ]
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--starts", type=int, default=4, help="rooms and cameras of each kind")
    parser.add_argument("--frames", type=int, default=120, help="of each run")
    options = parser.parse_args()
    rows = []
    for (bands, size), (extrinsic, (shift, turn)) in product(BANDS.items(), EXTRINSICS.items()):
        faults = KinectFaults(depth_bands=size, extrinsic_shift=shift, extrinsic_turn=turn)
        rooms = [
            SyntheticRecording(num_frames=options.frames, seed=seed, faults=faults)
            for seed in range(options.starts)
        ]
        sums = [heard(room) for room in rooms]
        for name, prior in PRIORS.items():
            found = np.stack([errors(told, room, prior) for told, room in zip(sums, rooms, strict=True)])
            mean, most = found.mean(axis=0), found[:, 4].max()
            rows.append((bands, extrinsic, name, *(f"{x:.1f}" for x in (*mean, most))))
        jax.clear_caches()
    print_table("errors of depth, by what is believed before the first frame", COLUMNS, rows)


if __name__ == "__main__":
    main()
