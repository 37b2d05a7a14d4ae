"""`exposure.txt`: exposures of the frames of a run, against the colours of its map."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError, checked, excerpt, file_text

EXPOSURE_FILE = "exposure.txt"
"""Name of the file in the folder of a run."""

_HEADER = "# timestamp gain_r gain_g gain_b"


@checked
def format_gains(timestamps: Float[np.ndarray, " n"], gains: Float[np.ndarray, "n 3"]) -> str:
    """Gains as text: the time stamp and three gains a line.

    Args:
        timestamps: seconds.
        gains: of red, green and blue.
    """
    rows = zip(timestamps, gains, strict=True)
    lines = [f"{t:.6f} " + " ".join(f"{value:.6f}" for value in row) for t, row in rows]
    return "".join(line + "\n" for line in [_HEADER, *lines])


@checked
def read_gains(path: Path | str) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Time stamps and gains of a file that `format_gains` wrote.

    Args:
        path: of the file.

    Raises:
        InputError: there is no such file, or a line is not four finite numbers, the gains positive.
    """
    try:
        lines = [line for line in file_text(path).splitlines() if line and not line.startswith("#")]
        table = np.asarray([[float(word) for word in line.split()] for line in lines]).reshape(len(lines), 4)
    except (OSError, ValueError) as error:
        raise InputError(f"Cannot read the exposures {path}: {excerpt(error)}.") from error
    if not ((np.abs(table) < 1e12).all() and (table[:, 1:] > 0).all()):
        raise InputError(f"The exposures {path} are not finite and positive.")
    return table[:, 0], table[:, 1:]
