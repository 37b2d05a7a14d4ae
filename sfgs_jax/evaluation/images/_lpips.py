"""LPIPS, the learned perceptual distance, on SqueezeNet 1.1's features.

Source: Zhang et al., The unreasonable effectiveness of deep features as a perceptual metric, CVPR 2018,
version 0.1 of its linear layers; Iandola et al., SqueezeNet, 2016, as numbered by torchvision's
`squeezenet1_1().features`.
"""

import os
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sfgs_jax.arrays import InputError, checked, excerpt, require_file

_FILE = "weights/lpips_squeeze_v0.1.npz"

# The network's inputs in [-1, 1] are normalised by these, per RGB channel.
_SHIFT = (-0.030, -0.088, -0.188)
_SCALE = (0.458, 0.448, 0.450)

# Layers of `features`: fire modules by their number, "pool", and "tap" where a distance is taken.
_LAYERS = ("tap", "pool", 3, 4, "tap", "pool", 6, 7, "tap", "pool", 9, "tap", 10, "tap", 11, "tap", 12, "tap")


class Convolution(eqx.Module):
    """Weights of one convolution.

    Attributes:
        weight: filters of a square size.
        bias: added to each output channel.
    """

    weight: Float[Array, "size size in out"]
    bias: Float[Array, " out"]

    def __call__(self, x: Float[Array, "b h w in"], *, stride: int = 1) -> Float[Array, "b i j out"]:
        """ReLU of the convolution; 3 x 3 filters are padded unless strided, as in SqueezeNet."""
        pad = self.weight.shape[0] // 2 if stride == 1 else 0
        y = jax.lax.conv_general_dilated(
            x,
            self.weight,
            (stride, stride),
            ((pad, pad), (pad, pad)),
            dimension_numbers=("NHWC", "HWIO", "NHWC"),
        )
        return jax.nn.relu(y + self.bias[None, None, None])


class Fire(eqx.Module):
    """A fire module: 1 x 1 down, then 1 x 1 and 3 x 3 up side by side."""

    squeeze: Convolution
    expand1: Convolution
    expand3: Convolution

    def __call__(self, x: Float[Array, "b h w c"]) -> Float[Array, "b h w d"]:
        """The two expansions, concatenated over channels."""
        x = self.squeeze(x)
        return jnp.concatenate([self.expand1(x), self.expand3(x)], axis=-1)


class LpipsWeights(eqx.Module):
    """SqueezeNet 1.1 up to its last fire module, and the linear layer of each of the seven taps.

    Attributes:
        stem: the first convolution.
        fires: fire modules by their number in torchvision's `features`.
        linear: seven vectors of channel weights, none negative.
    """

    stem: Convolution
    fires: dict[int, Fire]
    linear: tuple[Float[Array, " _"], ...]


@checked
def default_lpips_path() -> Path:
    """Default path of the weights: under SFGS_DATA, else in `shared` beside the repository."""
    root = os.environ.get("SFGS_DATA")
    return (Path(root) if root else Path(__file__).parents[4] / "shared") / _FILE


@checked
def load_lpips(path: Path | str | None = None) -> LpipsWeights:
    """Read the weights: an npz with `backbone.N...` (torchvision's layout) and `linN.model.1.weight`.

    Args:
        path: the file; None means `default_lpips_path()`.

    Raises:
        InputError: there is no such file, or it holds something else.
    """
    path = default_lpips_path() if path is None else Path(path)
    try:
        require_file(path)
        with np.load(path) as file:
            return _weights(dict(file))
    except Exception as error:  # NumPy's reader raises whatever a broken archive trips
        raise InputError(f"Cannot read the LPIPS weights {path}: {excerpt(error)}.") from error


def _weights(arrays: dict[str, np.ndarray]) -> LpipsWeights:
    def convolution(name: str) -> Convolution:
        weight = arrays[f"backbone.{name}.weight"].transpose(2, 3, 1, 0)
        return Convolution(jnp.asarray(weight), jnp.asarray(arrays[f"backbone.{name}.bias"]))

    numbers = [layer for layer in _LAYERS if isinstance(layer, int)]
    taps = sum(layer == "tap" for layer in _LAYERS)
    return LpipsWeights(
        stem=convolution("0"),
        fires={
            n: Fire(*(convolution(f"{n}.{part}") for part in ("squeeze", "expand1x1", "expand3x3")))
            for n in numbers
        },
        linear=tuple(jnp.asarray(arrays[f"lin{i}.model.1.weight"].reshape(-1)) for i in range(taps)),
    )


def max_pool(x: Float[Array, "b h w c"]) -> Float[Array, "b i j c"]:
    """3 x 3 maximum pooling at stride 2 in ceil mode: windows past the last row or column count."""
    pads = [max(-(-(n - 3) // 2) * 2 + 3 - n, 0) for n in x.shape[1:3]]
    return jax.lax.reduce_window(
        x, -jnp.inf, jax.lax.max, (1, 3, 3, 1), (1, 2, 2, 1), ((0, 0), (0, pads[0]), (0, pads[1]), (0, 0))
    )


def unit_length(x: Float[Array, "*b c"]) -> Float[Array, "*b c"]:
    """Features scaled to unit length over channels; all-zero features stay zero, with zero gradients."""
    squares = jnp.sum(x * x, axis=-1, keepdims=True)
    some = squares > 0
    return jnp.where(some, x / (jnp.sqrt(jnp.where(some, squares, 1)) + 1e-10), 0)


def feature_distance(
    a: Float[Array, "h w c"], b: Float[Array, "h w c"], weights: Float[Array, " c"]
) -> Float[Array, ""]:
    """Weighted squared distance of the features' directions, averaged over positions.

    Args:
        a: features of one image.
        b: features of the other.
        weights: weight of each channel.
    """
    return jnp.mean((unit_length(a) - unit_length(b)) ** 2 @ weights)


@checked
def lpips(weights: LpipsWeights, a: Float[Array, "H W 3"], b: Float[Array, "H W 3"]) -> Float[Array, ""]:
    """Perceptual distance of two images; 0 for equal ones.

    Args:
        weights: the network.
        a: RGB in [0, 1], at least 33 pixels a side.
        b: RGB in [0, 1].
    """
    x = 2 * jnp.stack([a, b]) - 1
    shift, scale = (jnp.asarray(c, x.dtype).reshape(1, 1, 1, 3) for c in (_SHIFT, _SCALE))
    x = (x - shift) / scale
    x = weights.stem(x, stride=2)
    distance = jnp.zeros((), x.dtype)
    linear = iter(weights.linear)
    for layer in _LAYERS:
        if layer == "tap":
            distance += feature_distance(x[0], x[1], next(linear))
        elif layer == "pool":
            x = max_pool(x)
        else:
            x = weights.fires[int(layer)](x)
    return distance
