"""Weights of the network in safetensors files."""

from importlib.resources import files
from pathlib import Path

import jax
import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from sfgs_jax.arrays import InputError, checked, excerpt, file_bytes, write_atomically
from sfgs_jax.superfeats.network._layers import fold
from sfgs_jax.superfeats.network._network import Network, NetworkConfig, initialise_network

# Beyond it activations overflow.
_LARGEST = 1e6


@checked
def save_weights(path: Path | str, network: Network) -> None:
    """Write a network, folded; an interrupted write leaves no half file.

    Args:
        path: the safetensors file; one that exists is replaced.
        network: folded or not.

    Raises:
        OSError: the file can't be written; an older one is left untouched.
    """
    leaves = jax.tree_util.tree_leaves_with_path(fold(network))
    write_atomically(path, save({_name(place): np.asarray(leaf) for place, leaf in leaves}))


@checked
def load_weights(path: Path | str | None = None, *, config: NetworkConfig | None = None) -> Network:
    """Read a folded network.

    Args:
        path: a safetensors file; None means the weights that come with the package.
        config: widths of the network in the file; None means the defaults.

    Raises:
        InputError: the file is missing, is no safetensors file, holds other arrays than the network, or
            a value that is not finite.
    """
    shipped = files("sfgs_jax.superfeats.network") / "superfeats.safetensors"
    source = Path(path) if path is not None else shipped
    try:
        found = load(file_bytes(str(source)))
    except FileNotFoundError:
        raise InputError(f"There is no {source}.") from None
    except (SafetensorError, OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{source} can't be read as a safetensors file: {excerpt(error)}") from None
    shapes = jax.eval_shape(lambda: fold(initialise_network(jax.random.key(0), config or NetworkConfig())))
    wanted = {_name(place): leaf.shape for place, leaf in jax.tree_util.tree_leaves_with_path(shapes)}
    if {name: array.shape for name, array in found.items()} != wanted:
        raise InputError(f"{source} holds no SuperFeats network of these widths.")
    if not all(array.dtype == np.float32 and np.all(np.abs(array) < _LARGEST) for array in found.values()):
        raise InputError(f"{source} holds weights that are not float32, or not finite; the file is damaged.")
    # All at once: one by one, each shape would compile a program of its own.
    return jax.device_put(jax.tree_util.tree_map_with_path(lambda place, _: found[_name(place)], shapes))


def _name(place: tuple) -> str:
    return jax.tree_util.keystr(place, simple=True, separator=".")
