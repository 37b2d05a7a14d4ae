"""Covariances of a trajectory's poses as a text file, a line a pose."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError, checked, excerpt, file_text

_HEADER = (
    "# timestamp, covariance of x y z (m) and turns about x y z (rad) in the camera: upper triangle by rows"
)
_UPPER = np.triu_indices(6)


@checked
def format_covariances(timestamps: Float[np.ndarray, " n"], covariances: Float[np.ndarray, "n 6 6"]) -> str:
    """Covariances of pose tangents as text: the time stamp and 21 numbers a line.

    The tangents perturb `T_world_cam` on the right, translation first.

    Args:
        timestamps: seconds.
        covariances: metres and radians.
    """
    lines = [
        f"{t:.6f} " + " ".join(f"{value:.6e}" for value in covariance[_UPPER])
        for t, covariance in zip(timestamps, covariances, strict=True)
    ]
    return "".join(line + "\n" for line in [_HEADER, *lines])


@checked
def read_covariances(path: Path | str) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 6 6"]]:
    """Time stamps and covariances of a file that `format_covariances` wrote.

    Args:
        path: of the file.

    Raises:
        InputError: there is no such file, or a line is not 22 finite numbers.
    """
    try:
        lines = [line for line in file_text(path).splitlines() if line and not line.startswith("#")]
        table = np.asarray([[float(word) for word in line.split()] for line in lines])
        table = table.reshape(len(lines), 1 + len(_UPPER[0]))
    except (OSError, ValueError) as error:
        raise InputError(f"Cannot read the covariances {path}: {excerpt(error)}.") from error
    if not (np.abs(table) < 1e12).all():
        raise InputError(f"The covariances {path} are not finite.")
    covariances = np.zeros((len(table), 6, 6))
    covariances[:, *_UPPER] = covariances[:, *_UPPER[::-1]] = table[:, 1:]
    return table[:, 0], covariances
