"""The SuperFeats network: a description branch and a detection branch over one grey image.

Everything runs at a quarter of the image's resolution or below, where convolutions have enough channels to be
fast.

Source: Wang and Deng, SFGS-SLAM (2025), section 3.1.
"""

from dataclasses import dataclass
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from sfgs_jax.arrays import InputError
from sfgs_jax.superfeats.network._layers import (
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
"""Side of a cell, pixels. Descriptors and detections are computed at 1/8 of the image's size."""

STRIDE = 32
"""Side of a cell of the coarsest level, pixels. The sides of the network's input are multiples of it."""

DESCRIPTOR_SIZE = 64
"""Length of a descriptor."""


@dataclass(frozen=True)
class NetworkConfig:
    """Widths of the network.

    Raises:
        InputError: a level's channels are odd or not positive, or another number is out of its range.
    """

    channels: tuple[int, ...] = (16, 32, 64, 96)
    """Channels of the description branch's levels at 1/4, 1/8, 1/16 and 1/32 of the image; even."""

    bottlenecks: tuple[int, int, int, int] = (1, 1, 1, 1)
    """Residual bottlenecks in the C2f blocks at 1/4, 1/8, 1/16 and 1/32 of the image; 0 or more."""

    context: int = 16
    """Channels of the detection branch's module that looks at neighbouring cells; at least 1."""

    def __post_init__(self) -> None:
        numbers = (*self.channels, *self.bottlenecks, self.context)
        whole = all(isinstance(number, int) and not isinstance(number, bool) for number in numbers)
        even = all(channels > 0 and channels % 2 == 0 for channels in self.channels)
        counts = (*self.bottlenecks, self.context - 1)
        lengths = len(self.channels), len(self.bottlenecks)
        if not whole or lengths != (4, 4) or not even or min(counts) < 0:
            raise InputError(
                f"{self}: four levels need even positive channels and bottlenecks of 0 or more, "
                "and context must be positive."
            )


class C2f(eqx.Module):
    """C2f, the cross-stage-partial block of YOLOv8.

    Half of the channels pass through a chain of residual bottlenecks. All stages' outputs are merged.

    Attributes:
        split: 1 x 1 convolution before the chain.
        bottlenecks: pairs of 3 x 3 convolutions.
        merge: 1 x 1 convolution of all stages' outputs.
    """

    split: Layer
    bottlenecks: tuple[tuple[Layer, Layer], ...]
    merge: Layer

    def __call__(self, x: Float[Array, "c b h w"], apply: Apply) -> Float[Array, "c b h w"]:
        """Run the block with `apply` for its layers."""
        x = apply(self.split, x)
        parts = list(jnp.split(x, 2))
        for first, second in self.bottlenecks:
            parts.append(parts[-1] + apply(second, apply(first, parts[-1])))
        return apply(self.merge, jnp.concatenate(parts))


class Level(eqx.Module):
    """One level of the description branch.

    Attributes:
        reduce: 3 x 3 convolution to the level's resolution.
        block: its C2f block.
    """

    reduce: Layer
    block: C2f


class Fusion(eqx.Module):
    """Fusion block: brings a coarse level to the width of the next finer one and merges the two.

    Attributes:
        project: 1 x 1 convolution of the coarse level.
        merge: 3 x 3 convolution of the sum.
    """

    project: Layer
    merge: Layer

    def __call__(
        self, fine: Float[Array, "c b h w"], coarse: Float[Array, "d b h2 w2"], apply: Apply
    ) -> Float[Array, "o b h w"]:
        """Merge the two levels with `apply` for the layers."""
        coarse = apply(self.project, coarse)
        return apply(self.merge, fine + _double(coarse))


class Network(eqx.Module):
    """Parameters of SuperFeats, with batch normalisations or folded.

    Attributes:
        levels: the description branch's four levels, from fine to coarse.
        fusions: of 1/32 into 1/16, and of 1/16 into 1/8.
        describe: 1 x 1 convolution to descriptors.
        rely: 1 x 1 convolution to the logit of reliability.
        cell_layers: the detection branch's 2 x 2 and 1 x 1 convolutions of cells.
        context: its convolutional module, which narrows, looks at the cells around, and widens.
        detect: 1 x 1 convolution to the 65 logits of keypoints.
        shift: (2,) pixels (u, v) added to keypoints. No loss sees an error that all keypoints have in common,
            so it is measured after the training (`experiments.keypoint_bias`).
    """

    levels: tuple[Level, ...]
    fusions: tuple[Fusion, Fusion]
    describe: Convolution
    rely: Convolution
    cell_layers: tuple[Layer, Layer]
    context: tuple[Layer, Layer, Layer]
    detect: Convolution
    shift: Float[Array, "2"]


class DenseFeatures(eqx.Module):
    """Outputs of the network for each 8 x 8 cell.

    Attributes:
        logits: (B, H/8, W/8, 65) of the keypoint's place in the cell, row by row, and of no keypoint.
        descriptors: (B, H/8, W/8, 64) of any length.
        reliability: (B, H/8, W/8) logits of the probability that a descriptor finds its counterpart.
    """

    logits: Float[Array, "b h w 65"]
    descriptors: Float[Array, "b h w 64"]
    reliability: Float[Array, "b h w"]


@partial(jax.jit, static_argnames="config")
def initialise_network(key: PRNGKeyArray, config: NetworkConfig = NetworkConfig()) -> Network:
    """A network with random weights, to be trained.

    Args:
        key: of the random numbers.
        config: widths, static.
    """
    count = Noise(None)
    jax.eval_shape(lambda: _build(config, count))
    return _build(config, Noise(jax.random.normal(key, (count.taken,))))


def normalise(images: Float[Array, "b h w"]) -> Float[Array, "b h w"]:
    """Images with zero mean and unit standard deviation."""
    centred = images - images.mean((1, 2), keepdims=True)
    return centred * jax.lax.rsqrt(jnp.square(centred).mean((1, 2), keepdims=True) + 1e-5)


def forward(network: Network, images: Float[Array, "b h w"], apply: Apply = apply_folded) -> DenseFeatures:
    """Run both branches and their last, linear layers at every cell.

    Args:
        network: folded, unless `apply` is a `BatchStatistics`.
        images: (B, H, W) normalised grey images whose sides are multiples of 32.
        apply: applies the hidden layers; the default is that of a folded network.

    Raises:
        InputError: the network is not folded, and `apply` is no `BatchStatistics`.
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
    """Run both branches, without the linear layers `describe` and `rely`. Arguments are those of `forward`.

    Returns:
        Logits of keypoints (65, B, H/8, W/8), channel by channel, and the inputs (B, H/8, W/8, 64) of
        `describe` and `rely`, cell by cell.
    """
    x = _space_to_depth(images, 4)
    outputs = []
    for index, level in enumerate(network.levels):
        x = level.block(apply(level.reduce, x, stride=1 if index == 0 else 2), apply)
        outputs.append(x)
    _, x8, x16, x32 = outputs
    x16 = network.fusions[0](x16, x32, apply)
    x8 = network.fusions[1](x8, x16, apply)

    # The grid is shifted by half a cell, so that the first layer's 2 x 2 see 4 pixels beyond each cell. Most
    # pixels of a cell lie too near its border to be told from their neighbours by the cell alone.
    half = (CELL // 2, CELL // 2)
    cells = _space_to_depth(jnp.pad(images, ((0, 0), half, half)), CELL)
    for layer in network.cell_layers:
        cells = apply(layer, cells)
    narrow, look_around, widen = network.context
    cells = cells + apply(widen, apply(look_around, apply(narrow, cells)))
    logits = convolve(network.detect.weight, cells) + of_channels(network.detect.bias)
    return logits, jnp.moveaxis(x8, 0, -1)


def linear(layer: Convolution, x: Float[Array, "*n i"]) -> Float[Array, "*n o"]:
    """A 1 x 1 convolution of cells, channels last."""
    return x @ layer.weight[:, 0, 0].T + layer.bias.reshape((1,) * (x.ndim - 1) + (-1,))


def _space_to_depth(images: Float[Array, "b h w"], size: int) -> Float[Array, "d b h2 w2"]:
    """Blocks of size x size pixels as channels."""
    b, h, w = images.shape
    x = images.reshape(b, h // size, size, w // size, size).transpose(2, 4, 0, 1, 3)
    return x.reshape(size * size, b, h // size, w // size)


def _double(x: Float[Array, "c b h w"]) -> Float[Array, "c b h2 w2"]:
    """Nearest-neighbour upsampling by two."""
    return jnp.repeat(jnp.repeat(x, 2, axis=2), 2, axis=3)


def _build(config: NetworkConfig, noise: Noise) -> Network:
    """A network of the configured widths, with weights from `noise`."""

    def layer(size: int, inputs: int, outputs: int) -> Layer:
        return initialise(noise, size, inputs, outputs)

    def c2f(channels: int, bottlenecks: int) -> C2f:
        half = channels // 2
        chain = tuple((layer(3, half, half), layer(3, half, half)) for _ in range(bottlenecks))
        split = layer(1, channels, channels)
        merge = layer(1, half * (2 + bottlenecks), channels)
        return C2f(split=split, bottlenecks=chain, merge=merge)

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
        shift=jnp.zeros(2),
    )
