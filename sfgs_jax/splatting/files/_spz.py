"""SPZ files: quantised and compressed, for transport."""

from pathlib import Path

from sfgs_jax.arrays import InputError, checked, excerpt, file_bytes, write_atomically
from sfgs_jax.splatting._gaussians import Gaussians, valid_arrays
from sfgs_jax.splatting.files._axes import half_turned
from sfgs_jax.splatting.files._loaded import loaded
from sfgs_jax.splatting.files._spz_container import MOST_GAUSSIANS, Header, Version, packed, unpacked
from sfgs_jax.splatting.files._spz_streams import fractional_bits, streams_of, values_of


@checked
def save_spz(path: Path | str, gaussians: Gaussians, *, version: Version = 3) -> None:
    """Write the valid Gaussians as an SPZ file.

    The axes of the file are x right, y up, z backward; rotations and harmonics turn along. Positions are
    multiples of 0.24 mm, and scales of 6 percent, from 45 µm to 380 m. Opacities and colours have 8 bits,
    and so have higher harmonics, within [-1, 1]. Components of a rotation are exact to 0.001.

    Args:
        path: the file; one that exists is replaced.
        gaussians: the map.
        version: 3 is compressed with gzip, 4 with zstd.

    Raises:
        InputError: there are more than ten million Gaussians, one is 4000 km away, or version 4 is asked for
            and no zstd is installed (`pip install 'sfgs-jax[spz4]'`).
        OSError: the file can't be written; an older one is left untouched.

    Source: github.com/nianticlabs/spz.
    """
    values = half_turned(valid_arrays(gaussians))
    count, coefficients = values["sh"].shape[:2]
    if count > MOST_GAUSSIANS:
        raise InputError(f"SPZ holds {MOST_GAUSSIANS} Gaussians at most, not {count}.")
    bits = fractional_bits(values["means"])
    write_atomically(path, packed(Header(count, coefficients, bits), streams_of(values, bits), version))


@checked
def load_spz(path: Path | str) -> Gaussians:
    """Read an SPZ file of version 3 or 4; every Gaussian in it is valid.

    Raises:
        InputError: the file can't be read, is no SPZ file of these versions, is damaged or has extensions, or
            has version 4 while no zstd is installed.

    Source: as for `save_spz`.
    """
    path = Path(path)
    try:
        header, streams = unpacked(file_bytes(path))
    except (OSError, ValueError) as error:
        raise InputError(f"Cannot read {path} as an SPZ file: {excerpt(error)}.") from error
    values = half_turned(values_of(streams, header.num_gaussians, header.coefficients, header.bits))
    return loaded(path, **values)
