"""Convolutions, with and without batch normalisation.

Maps lie channel by channel, (channels, batch, height, width). So a convolution is one product of its weights
with whole maps, long rows of memory, which for as few channels as ours is faster on a CPU than the
convolution of channels kept together at each pixel.
"""

import math
from collections.abc import Callable
from typing import TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

_MOMENTUM = 0.99
_VARIANCE_FLOOR = 1e-5


class Convolution(eqx.Module):
    """A convolution with a bias; `weight` is (outputs, height, width, inputs)."""

    weight: Float[Array, "o kh kw i"]
    bias: Float[Array, " o"]


class NormalisedConvolution(eqx.Module):
    """A convolution followed by batch normalisation: what is trained, before it is folded.

    `mean` and `variance` follow the batches seen; they are used by nothing but `fold`.
    """

    weight: Float[Array, "o kh kw i"]
    scale: Float[Array, " o"]
    offset: Float[Array, " o"]
    mean: Float[Array, " o"]
    variance: Float[Array, " o"]


Layer: TypeAlias = Convolution | NormalisedConvolution
Apply: TypeAlias = Callable[..., Float[Array, "o b h w"]]
"""How a hidden layer acts: `apply(layer, x, stride=1)`, its non-linearity included."""


class Noise:
    """Normal random numbers, handed out in arrays of any shape: drawn at once, they are one small program
    instead of one for each shape."""

    def __init__(self, stock: Float[Array, " n"] | None) -> None:
        """Hand out `stock`; or, if None, zeros, to see how many numbers it takes."""
        self._stock = stock
        self.taken = 0

    def take(self, *shape: int) -> Float[Array, "..."]:
        """The next numbers."""
        start = self.taken
        self.taken += math.prod(shape)
        return jnp.zeros(shape) if self._stock is None else self._stock[start : self.taken].reshape(shape)


def initialise(noise: Noise, size: int, inputs: int, outputs: int) -> NormalisedConvolution:
    """He-normal weights; a normalisation that changes nothing yet."""
    weight = noise.take(outputs, size, size, inputs) * math.sqrt(2 / (size * size * inputs))
    zeros, ones = jnp.zeros(outputs), jnp.ones(outputs)
    return NormalisedConvolution(weight, scale=ones, offset=zeros, mean=zeros, variance=ones)


def initialise_linear(noise: Noise, inputs: int, outputs: int) -> Convolution:
    """A 1x1 layer without normalisation, for the outputs of the network."""
    return Convolution(noise.take(outputs, 1, 1, inputs) / math.sqrt(inputs), jnp.zeros(outputs))


def convolve(
    weight: Float[Array, "o k k i"], x: Float[Array, "i b h w"], *, stride: int = 1
) -> Float[Array, "o b h2 w2"]:
    """A convolution whose output has 1/stride of the input's size, padded by zeros around the image.

    One of 2x2 has no padding: what it puts out lies between its inputs, one fewer to each side.
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
    # Of the taps below each other, products shifted and summed take less time than a copy for each.
    products = weight.reshape(outputs * size, -1) @ x.reshape(size * inputs, -1)
    products = products.reshape(outputs, size, b, rows, w)
    return sum((products[:, row, :, row : row + h] for row in range(1, size)), start=products[:, 0, :, :h])


def apply_folded(layer: Layer, x: Float[Array, "i b h w"], *, stride: int = 1) -> Float[Array, "o b h2 w2"]:
    """Convolution and ReLU of a folded network.

    The SiLU of YOLOv8's blocks costs an eighth of the whole forward pass on a CPU.
    """
    assert isinstance(layer, Convolution), "fold the network first"
    return jax.nn.relu(convolve(layer.weight, x, stride=stride) + of_channels(layer.bias))


def of_channels(values: Float[Array, " o"]) -> Float[Array, "o 1 1 1"]:
    """A value for each channel of maps."""
    return values[:, None, None, None]


class BatchStatistics:
    """Convolution, batch normalisation and ReLU, remembering each layer's statistics for `updated`.

    The mean runs over the whole batch, also when the batch lies on several devices.
    """

    def __init__(self) -> None:
        self._seen: dict[int, tuple[Array, Array]] = {}

    def __call__(
        self, layer: Layer, x: Float[Array, "i b h w"], *, stride: int = 1
    ) -> Float[Array, "o b h2 w2"]:
        """Acts with the statistics of this batch."""
        assert isinstance(layer, NormalisedConvolution), "a folded network has no statistics"
        y = convolve(layer.weight, x, stride=stride)
        mean = y.mean((1, 2, 3))
        variance = y.var((1, 2, 3))
        self._seen[id(layer)] = (mean, variance)
        gain = layer.scale * lax.rsqrt(variance + _VARIANCE_FLOOR)
        return jax.nn.relu((y - of_channels(mean)) * of_channels(gain) + of_channels(layer.offset))

    def updated(self, network):
        """The network with its running statistics moved towards those of this batch."""

        def update(layer):
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
def fold(network):
    """The same network with each normalisation worked into its convolution."""

    def folded(layer):
        if not isinstance(layer, NormalisedConvolution):
            return layer
        gain = layer.scale * lax.rsqrt(layer.variance + _VARIANCE_FLOOR)
        return Convolution(layer.weight * of_channels(gain), layer.offset - layer.mean * gain)

    return jax.tree.map(folded, network, is_leaf=lambda node: isinstance(node, NormalisedConvolution))
