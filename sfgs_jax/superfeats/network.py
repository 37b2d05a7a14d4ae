"""The SuperFeats network: a description branch and a detection branch over one grey image.

After SFGS-SLAM (Wang and Deng, 2025), section 3.1. Everything runs at a quarter of the image's resolution
or below, where convolutions have enough channels to be fast.
"""

from dataclasses import dataclass
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from sfgs_jax.superfeats.layers import (
    Apply,
    Convolution,
    Layer,
    Noise,
    apply_folded,
    convolve,
    initialise,
    initialise_linear,
    of_channels,
)

CELL = 8
"""Pixels along the side of a cell: descriptors and detections are computed at 1/8 of the image's size."""

STRIDE = 32
"""The network takes images whose sides are multiples of this."""

DESCRIPTOR_SIZE = 64


@dataclass(frozen=True)
class NetworkConfig:
    """Widths of the network."""

    channels: tuple[int, int, int, int] = (16, 32, 64, 96)
    """Of the description branch at 1/4, 1/8, 1/16 and 1/32."""

    bottlenecks: tuple[int, int, int, int] = (1, 1, 1, 1)
    """In the C2f block of each of these levels."""

    context: int = 16
    """Channels of the convolutional module of the detection branch."""


class C2f(eqx.Module):
    """The cross-stage-partial block of YOLOv8: half of the channels pass through a chain of residual
    bottlenecks, and every stage's output is kept and merged."""

    split: Layer
    bottlenecks: tuple[tuple[Layer, Layer], ...]
    merge: Layer

    def __call__(self, x: Float[Array, "c b h w"], apply: Apply) -> Float[Array, "c b h w"]:
        """Runs the block with `apply` for its layers."""
        x = apply(self.split, x)
        parts = list(jnp.split(x, 2))
        for first, second in self.bottlenecks:
            parts.append(parts[-1] + apply(second, apply(first, parts[-1])))
        return apply(self.merge, jnp.concatenate(parts))


class Level(eqx.Module):
    """A convolution, to the next resolution, and its C2f block."""

    reduce: Layer
    block: C2f


class Fusion(eqx.Module):
    """Brings a coarse level to the width of the next finer one and merges the two."""

    project: Layer
    merge: Layer

    def __call__(
        self, fine: Float[Array, "c b h w"], coarse: Float[Array, "d b h2 w2"], apply: Apply
    ) -> Float[Array, "o b h w"]:
        """Merges the two levels with `apply` for its layers."""
        coarse = apply(self.project, coarse)
        return apply(self.merge, fine + _double(coarse))


class Network(eqx.Module):
    """Parameters of SuperFeats, trained or folded."""

    levels: tuple[Level, ...]
    fusions: tuple[Fusion, Fusion]
    describe: Convolution
    rely: Convolution
    cell_layers: tuple[Layer, Layer]
    context: tuple[Layer, Layer, Layer]
    detect: Convolution


class DenseFeatures(eqx.Module):
    """What the network says of each 8x8 cell.

    Attributes:
        logits: (B, H/8, W/8, 65) of the keypoint's place in the cell, row by row, and of there being none.
        descriptors: (B, H/8, W/8, 64), of no particular length.
        reliability: (B, H/8, W/8) logit of the descriptors there finding their counterpart.
    """

    logits: Float[Array, "b h w 65"]
    descriptors: Float[Array, "b h w 64"]
    reliability: Float[Array, "b h w"]


@partial(jax.jit, static_argnames="config")
def initialise_network(key: PRNGKeyArray, config: NetworkConfig = NetworkConfig()) -> Network:
    """A network with random weights, to be trained."""
    count = Noise(None)
    jax.eval_shape(lambda: _build(config, count))
    return _build(config, Noise(jax.random.normal(key, (count.taken,))))


def normalise(images: Float[Array, "b h w"]) -> Float[Array, "b h w"]:
    """Each image with zero mean and unit standard deviation."""
    centred = images - images.mean((1, 2), keepdims=True)
    return centred * jax.lax.rsqrt(jnp.square(centred).mean((1, 2), keepdims=True) + 1e-5)


def forward(network: Network, images: Float[Array, "b h w"], apply: Apply = apply_folded) -> DenseFeatures:
    """Runs both branches and their last, linear layers everywhere.

    Args:
        network: folded, unless `apply` is a `BatchStatistics`.
        images: normalised grey images whose sides are multiples of 32.
        apply: how hidden layers act.
    """
    logits, cells = branches(network, images, apply)
    return DenseFeatures(
        logits=jnp.moveaxis(logits, 0, -1),
        descriptors=linear(network.describe, cells),
        reliability=linear(network.rely, cells)[..., 0],
    )


def branches(
    network: Network, images: Float[Array, "b h w"], apply: Apply = apply_folded
) -> tuple[Float[Array, "65 b h//8 w//8"], Float[Array, "b h//8 w//8 64"]]:
    """Logits of keypoints, channel by channel, and, cell by cell, that of which `describe` and `rely` make
    descriptors and reliability.

    Arguments are those of `forward`.
    """
    x = _space_to_depth(images, 4)
    outputs = []
    for index, level in enumerate(network.levels):
        x = level.block(apply(level.reduce, x, stride=1 if index == 0 else 2), apply)
        outputs.append(x)
    _, x8, x16, x32 = outputs
    x16 = network.fusions[0](x16, x32, apply)
    x8 = network.fusions[1](x8, x16, apply)

    # Cut half a cell off the grid, so that the first layer's 2x2 see 4 pixels beyond each cell: most pixels
    # of a cell lie too near its border to be told from their neighbours by the cell alone.
    half = (CELL // 2, CELL // 2)
    cells = _space_to_depth(jnp.pad(images, ((0, 0), half, half)), CELL)
    for layer in network.cell_layers:
        cells = apply(layer, cells)
    narrow, look_around, widen = network.context
    cells = cells + apply(widen, apply(look_around, apply(narrow, cells)))
    logits = convolve(network.detect.weight, cells) + of_channels(network.detect.bias)
    return logits, jnp.moveaxis(x8, 0, -1)


def linear(layer: Convolution, x: Float[Array, "*n i"]) -> Float[Array, "*n o"]:
    """A 1x1 convolution of cells."""
    return x @ layer.weight[:, 0, 0].T + layer.bias


def _space_to_depth(images: Float[Array, "b h w"], size: int) -> Float[Array, "d b h2 w2"]:
    b, h, w = images.shape
    x = images.reshape(b, h // size, size, w // size, size).transpose(2, 4, 0, 1, 3)
    return x.reshape(size * size, b, h // size, w // size)


def _double(x: Float[Array, "c b h w"]) -> Float[Array, "c b h2 w2"]:
    return jnp.repeat(jnp.repeat(x, 2, axis=2), 2, axis=3)


def _build(config: NetworkConfig, noise: Noise) -> Network:
    def layer(size: int, inputs: int, outputs: int) -> Layer:
        return initialise(noise, size, inputs, outputs)

    def c2f(channels: int, bottlenecks: int) -> C2f:
        half = channels // 2
        chain = tuple((layer(3, half, half), layer(3, half, half)) for _ in range(bottlenecks))
        return C2f(layer(1, channels, channels), chain, layer(1, half * (2 + bottlenecks), channels))

    inputs = (16, *config.channels[:3])
    levels = tuple(
        Level(layer(3, before, channels), c2f(channels, bottlenecks))
        for before, channels, bottlenecks in zip(inputs, config.channels, config.bottlenecks, strict=True)
    )
    _, c8, c16, c32 = config.channels
    fusions = (
        Fusion(layer(1, c32, c16), layer(3, c16, c16)),
        Fusion(layer(1, c16, c8), layer(3, c8, DESCRIPTOR_SIZE)),
    )
    pixels = CELL * CELL
    return Network(
        levels=levels,
        fusions=fusions,
        describe=initialise_linear(noise, DESCRIPTOR_SIZE, DESCRIPTOR_SIZE),
        rely=initialise_linear(noise, DESCRIPTOR_SIZE, 1),
        cell_layers=(layer(2, pixels, pixels), layer(1, pixels, pixels)),
        context=(
            layer(1, pixels, config.context),
            layer(3, config.context, config.context),
            layer(1, config.context, pixels),
        ),
        detect=initialise_linear(noise, pixels, pixels + 1),
    )
