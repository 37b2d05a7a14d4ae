"""Convolutions, with and without batch normalisation."""

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
    """A convolution with a bias; `weight` is (height, width, inputs, outputs)."""

    weight: Float[Array, "kh kw i o"]
    bias: Float[Array, " o"]


class NormalisedConvolution(eqx.Module):
    """A convolution followed by batch normalisation: what is trained, before it is folded.

    `mean` and `variance` follow the batches seen; they are used by nothing but `fold`.
    """

    weight: Float[Array, "kh kw i o"]
    scale: Float[Array, " o"]
    offset: Float[Array, " o"]
    mean: Float[Array, " o"]
    variance: Float[Array, " o"]


Layer: TypeAlias = Convolution | NormalisedConvolution
Apply: TypeAlias = Callable[..., Float[Array, "b h w o"]]
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
    weight = noise.take(size, size, inputs, outputs) * math.sqrt(2 / (size * size * inputs))
    zeros, ones = jnp.zeros(outputs), jnp.ones(outputs)
    return NormalisedConvolution(weight, scale=ones, offset=zeros, mean=zeros, variance=ones)


def initialise_linear(noise: Noise, inputs: int, outputs: int) -> Convolution:
    """A 1x1 layer without normalisation, for the outputs of the network."""
    return Convolution(noise.take(1, 1, inputs, outputs) / math.sqrt(inputs), jnp.zeros(outputs))


def convolve(
    weight: Float[Array, "kh kw i o"], x: Float[Array, "b h w i"], *, stride: int = 1
) -> Float[Array, "b h2 w2 o"]:
    """A convolution whose output has 1/stride of the input's size, padded by zeros around the image.

    One of 2x2 has no padding and no stride: what it puts out lies between its inputs, one fewer to each side.
    """
    if weight.shape[0] == 2:
        return _between(weight, x)
    pad = weight.shape[0] // 2
    return lax.conv_general_dilated(
        x, weight, (stride, stride), [(pad, pad), (pad, pad)], dimension_numbers=("NHWC", "HWIO", "NHWC")
    )


def _between(weight: Float[Array, "2 2 i o"], x: Float[Array, "b h w i"]) -> Float[Array, "b h2 w2 o"]:
    """A 2x2 convolution as one product with all four taps, whose shifted sum takes two thirds of the time."""
    products = x @ weight.transpose(2, 0, 1, 3).reshape(x.shape[-1], -1)
    a, b, c, d = jnp.split(products, 4, axis=-1)
    return a[:, :-1, :-1] + b[:, :-1, 1:] + c[:, 1:, :-1] + d[:, 1:, 1:]


def apply_folded(layer: Layer, x: Float[Array, "b h w i"], *, stride: int = 1) -> Float[Array, "b h2 w2 o"]:
    """Convolution and ReLU of a folded network.

    The SiLU of YOLOv8's blocks costs an eighth of the whole forward pass on a CPU.
    """
    assert isinstance(layer, Convolution), "fold the network first"
    return jax.nn.relu(convolve(layer.weight, x, stride=stride) + layer.bias)


class BatchStatistics:
    """Convolution, batch normalisation and ReLU, remembering each layer's statistics for `updated`.

    The mean runs over the whole batch, also when the batch lies on several devices.
    """

    def __init__(self) -> None:
        self._seen: dict[int, tuple[Array, Array]] = {}

    def __call__(
        self, layer: Layer, x: Float[Array, "b h w i"], *, stride: int = 1
    ) -> Float[Array, "b h2 w2 o"]:
        """Acts with the statistics of this batch."""
        assert isinstance(layer, NormalisedConvolution), "a folded network has no statistics"
        y = convolve(layer.weight, x, stride=stride)
        mean = y.mean((0, 1, 2))
        variance = y.var((0, 1, 2))
        self._seen[id(layer)] = (mean, variance)
        gain = layer.scale * lax.rsqrt(variance + _VARIANCE_FLOOR)
        return jax.nn.relu((y - mean) * gain + layer.offset)

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
        return Convolution(layer.weight * gain, layer.offset - layer.mean * gain)

    return jax.tree.map(folded, network, is_leaf=lambda node: isinstance(node, NormalisedConvolution))
