"""`background.txt`: the colours behind the map of a run, by direction."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError, checked, excerpt, file_text

BACKGROUND_FILE = "background.txt"
"""Name of the file in the folder of a run."""

_HEADER = "# red green blue: spherical harmonics of degrees 0 to 2 in the map's axes, as of 3DGS"
_LARGEST = 1e6


@checked
def format_background(background: Float[np.ndarray, "9 3"]) -> str:
    """Coefficients as text, one of each channel a line.

    Args:
        background: (9, 3) coefficients; see `fitted_background`.
    """
    lines = [" ".join(f"{value:.6f}" for value in row) for row in background]
    return "".join(line + "\n" for line in [_HEADER, *lines])


@checked
def read_background(path: Path | str) -> Float[np.ndarray, "9 3"]:
    """Coefficients of a file that `format_background` wrote.

    Args:
        path: of the file.

    Raises:
        InputError: there is no such file, or it does not hold nine lines of three finite numbers.
    """
    try:
        lines = [line for line in file_text(path).splitlines() if line and not line.startswith("#")]
        table = np.asarray([[float(word) for word in line.split()] for line in lines]).reshape(9, 3)
    except (OSError, ValueError) as error:
        raise InputError(f"Cannot read the background {path}: {excerpt(error)}.") from error
    if not (np.abs(table) < _LARGEST).all():
        raise InputError(f"The background {path} is not finite.")
    return table
