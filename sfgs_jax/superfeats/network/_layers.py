"""Convolutions, with and without batch normalisation.

Maps lie channel by channel, (channels, batch, height, width). So a convolution is one product of its weights
with whole maps, long rows of memory. With few channels this is faster on a CPU than a convolution whose
channels lie together at each pixel.

These products stay at the default precision, TF32 on recent GPUs, whose tensor cores training needs. Rounding
to 10 bits hardly changes the features (tests/superfeats/test_exact_products.py).
"""

import math
from collections.abc import Callable
from typing import TypeAlias, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, PyTree

from sfgs_jax.arrays import InputError

_MOMENTUM = 0.99
"""Share of the running statistics that a new batch leaves."""

_VARIANCE_FLOOR = 1e-5
"""Added to variances before their root is divided by."""

_Tree = TypeVar("_Tree")


class Convolution(eqx.Module):
    """A convolution with a bias.

    Attributes:
        weight: (outputs, height, width, inputs).
        bias: (outputs,).
    """

    weight: Float[Array, "o kh kw i"]
    bias: Float[Array, " o"]


class NormalisedConvolution(eqx.Module):
    """A convolution followed by batch normalisation, for training; `fold` merges the two.

    Attributes:
        weight: (outputs, height, width, inputs).
        scale: (outputs,) factor after the normalisation.
        offset: (outputs,) summand after it.
        mean: (outputs,) running mean over the batches seen; only `fold` uses it.
        variance: (outputs,) running variance; only `fold` uses it.
    """

    weight: Float[Array, "o kh kw i"]
    scale: Float[Array, " o"]
    offset: Float[Array, " o"]
    mean: Float[Array, " o"]
    variance: Float[Array, " o"]


Layer: TypeAlias = Convolution | NormalisedConvolution
Apply: TypeAlias = Callable[..., Float[Array, "o b h w"]]
"""Applies a hidden layer with its non-linearity: `apply(layer, x, stride=1)`."""


class Noise:
    """A stock of normal random numbers, handed out in arrays of any shape.

    Drawn at once, they take one small program instead of one for each shape.
    """

    def __init__(self, stock: Float[Array, " n"] | None) -> None:
        """Hand out `stock`; zeros if it is None, to count how many numbers are taken."""
        self._stock = stock
        self.taken = 0

    def take(self, *shape: int) -> Float[Array, "..."]:
        """The next numbers."""
        start = self.taken
        self.taken += math.prod(shape)
        return jnp.zeros(shape) if self._stock is None else self._stock[start : self.taken].reshape(shape)


def initialise(noise: Noise, size: int, inputs: int, outputs: int) -> NormalisedConvolution:
    """A square convolution with He-normal weights, and a normalisation that changes nothing yet."""
    weight = noise.take(outputs, size, size, inputs) * math.sqrt(2 / (size * size * inputs))
    zeros, ones = jnp.zeros(outputs), jnp.ones(outputs)
    return NormalisedConvolution(weight, scale=ones, offset=zeros, mean=zeros, variance=ones)


def initialise_linear(noise: Noise, inputs: int, outputs: int) -> Convolution:
    """A 1 x 1 convolution without normalisation, for the outputs of the network."""
    return Convolution(noise.take(outputs, 1, 1, inputs) / math.sqrt(inputs), jnp.zeros(outputs))


def convolve(
    weight: Float[Array, "o k k i"], x: Float[Array, "i b h w"], *, stride: int = 1
) -> Float[Array, "o b h2 w2"]:
    """Convolution of maps.

    Odd sizes are padded by zeros, so that the output has 1 / stride of the input's size. One of 2 x 2 has no
    padding: its outputs lie between its inputs, one fewer along each side.

    Args:
        weight: (outputs, size, size, inputs).
        x: (inputs, batch, height, width).
        stride: pixels between outputs, static.
    """
    outputs, size, _, inputs = weight.shape
    pad = size // 2 if size % 2 else 0
    x = jnp.pad(x, ((0, 0), (0, 0), (pad, pad), (pad, pad)))
    _, b, rows, columns = x.shape
    h, w = ((side - size) // stride + 1 for side in (rows, columns))

    def shifted(x: Float[Array, "..."], count: int, axis: int) -> list[Float[Array, "..."]]:
        return [lax.slice_in_dim(x, tap, tap + stride * (count - 1) + 1, stride, axis) for tap in range(size)]

    x = jnp.concatenate(shifted(x, w, axis=3))
    if stride > 1:
        x = jnp.concatenate(shifted(x, h, axis=2))
        return (weight.reshape(outputs, -1) @ x.reshape(size * size * inputs, -1)).reshape(outputs, b, h, w)
    # Taps below each other: shifting and summing the products takes less time than copies of the input.
    products = weight.reshape(outputs * size, -1) @ x.reshape(size * inputs, -1)
    products = products.reshape(outputs, size, b, rows, w)
    return sum((products[:, row, :, row : row + h] for row in range(1, size)), start=products[:, 0, :, :h])


def apply_folded(layer: Layer, x: Float[Array, "i b h w"], *, stride: int = 1) -> Float[Array, "o b h2 w2"]:
    """Convolution and ReLU of a folded network.

    The SiLU of YOLOv8's blocks would cost an eighth of the whole forward pass on a CPU.

    Raises:
        InputError: the network is not folded.
    """
    if not isinstance(layer, Convolution):
        raise InputError("The network has batch normalisations; fold it first, or pass a BatchStatistics.")
    return jax.nn.relu(convolve(layer.weight, x, stride=stride) + of_channels(layer.bias))


def of_channels(values: Float[Array, " o"]) -> Float[Array, "o 1 1 1"]:
    """Values, one a channel, in a shape that broadcasts over maps."""
    return values[:, None, None, None]


class BatchStatistics:
    """Convolution, batch normalisation and ReLU, with the statistics of the batch.

    Each layer's statistics are remembered for `updated`. They are of the whole batch, also when it lies on
    several devices.
    """

    def __init__(self) -> None:
        self._seen: dict[int, tuple[Array, Array]] = {}

    def __call__(
        self, layer: Layer, x: Float[Array, "i b h w"], *, stride: int = 1
    ) -> Float[Array, "o b h2 w2"]:
        """Apply a layer, normalised by the statistics of this batch."""
        if not isinstance(layer, NormalisedConvolution):
            raise InputError("A folded network has no batch normalisations to train.")
        y = convolve(layer.weight, x, stride=stride)
        mean = y.mean((1, 2, 3))
        variance = y.var((1, 2, 3))
        self._seen[id(layer)] = (mean, variance)
        gain = layer.scale * lax.rsqrt(variance + _VARIANCE_FLOOR)
        return jax.nn.relu((y - of_channels(mean)) * of_channels(gain) + of_channels(layer.offset))

    def updated(self, network: _Tree) -> _Tree:
        """The network, its running statistics moved towards this batch's."""

        def update(layer: PyTree) -> PyTree:
            if not isinstance(layer, NormalisedConvolution):
                return layer
            mean, variance = lax.stop_gradient(self._seen[id(layer)])
            return eqx.tree_at(
                lambda old: (old.mean, old.variance),
                layer,
                (
                    _MOMENTUM * layer.mean + (1 - _MOMENTUM) * mean,
                    _MOMENTUM * layer.variance + (1 - _MOMENTUM) * variance,
                ),
            )

        return jax.tree.map(update, network, is_leaf=lambda node: isinstance(node, NormalisedConvolution))


@jax.jit
def fold(network: _Tree) -> _Tree:
    """The same network with each batch normalisation merged into its convolution."""

    def folded(layer: PyTree) -> PyTree:
        if not isinstance(layer, NormalisedConvolution):
            return layer
        gain = layer.scale * lax.rsqrt(layer.variance + _VARIANCE_FLOOR)
        return Convolution(layer.weight * of_channels(gain), layer.offset - layer.mean * gain)

    return jax.tree.map(folded, network, is_leaf=lambda node: isinstance(node, NormalisedConvolution))
