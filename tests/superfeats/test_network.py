"""The network: convolutions beside JAX's own, folding, widths, weights in files."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sfgs_jax.superfeats.network as room
from sfgs_jax.arrays import InputError
from sfgs_jax.superfeats.network import (
    DESCRIPTOR_SIZE,
    BatchStatistics,
    NetworkConfig,
    convolve,
    initialise_network,
    load_weights,
    normalise,
    save_weights,
)

# Compiled as a whole, as the library does. One by one the operations of a network are 200 programs.
fold, forward = jax.jit(room.fold), jax.jit(room.forward)


@pytest.fixture(scope="module")
def network():
    return initialise_network(jax.random.key(0))


def count(network) -> int:
    return sum(leaf.size for leaf in jax.tree.leaves(network))


def test_the_network_is_small(network):
    folded = fold(network)
    image = jax.ShapeDtypeStruct((1, 480, 640), jnp.float32)
    cost = forward.lower(folded, image).compile().cost_analysis()
    assert count(folded) <= 300_000
    # Multiply-adds count two operations each, and everything else is counted too.
    assert 0.3e9 < cost["flops"] / 2 < 0.9e9


def test_a_convolution_of_2x2_lies_between_its_inputs(rng):
    weight = jnp.asarray(rng.normal(size=(5, 2, 2, 3)), jnp.float32)
    x = jnp.asarray(rng.normal(size=(3, 2, 4, 6)), jnp.float32)
    expected = sum(
        jnp.tensordot(weight[:, row, column], x[:, :, row : row + 3, column : column + 5], 1)
        for row in (0, 1)
        for column in (0, 1)
    )
    np.testing.assert_allclose(convolve(weight, x), expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(("size", "stride"), [(1, 1), (3, 1), (3, 2)])
def test_convolutions_are_those_of_the_library(rng, size, stride):
    weight = jnp.asarray(rng.normal(size=(5, size, size, 3)), jnp.float32)
    x = jnp.asarray(rng.normal(size=(3, 2, 8, 6)), jnp.float32)
    expected = jax.lax.conv_general_dilated(
        x, weight, (stride, stride), [(size // 2, size // 2)] * 2, dimension_numbers=("CNHW", "OHWI", "CNHW")
    )
    np.testing.assert_allclose(convolve(weight, x, stride=stride), expected, rtol=1e-4, atol=1e-5)


def test_outputs_have_a_cell_for_each_8x8_pixels(network):
    dense = forward(fold(network), jnp.zeros((2, 96, 64)))
    assert dense.logits.shape == (2, 12, 8, 65)
    assert dense.descriptors.shape == (2, 12, 8, DESCRIPTOR_SIZE)
    assert dense.reliability.shape == (2, 12, 8)


def test_a_folded_network_acts_as_the_trained_one_on_the_statistics_it_has_seen(network, rng):
    images = normalise(jnp.asarray(rng.random((4, 32, 32)), jnp.float32))
    step = jax.jit(lambda net: _with_statistics(net, images))
    dense, network = step(network)
    # The running statistics approach those of this batch; where its variance is small that takes longest.
    for _ in range(1999):
        dense, network = step(network)
    folded = forward(fold(network), images)
    for trained, inferred in zip(jax.tree.leaves(dense), jax.tree.leaves(folded), strict=True):
        np.testing.assert_allclose(inferred, trained, atol=4e-3 * float(jnp.abs(trained).max()))


def _with_statistics(network, images):
    statistics = BatchStatistics()
    dense = room.forward(network, images, statistics)
    return dense, statistics.updated(network)


def test_brightness_and_contrast_change_nothing(network, rng):
    image = jnp.asarray(rng.random((1, 64, 64)), jnp.float32)
    folded = fold(network)
    plain = forward(folded, normalise(image))
    changed = forward(folded, normalise(0.5 * image + 0.2))
    for a, b in zip(jax.tree.leaves(plain), jax.tree.leaves(changed), strict=True):
        np.testing.assert_allclose(a, b, atol=2e-3)


def test_weights_come_back_from_their_file(network, tmp_path):
    path = tmp_path / "weights.safetensors"
    save_weights(path, network)
    assert path.stat().st_size <= 1_500_000
    for a, b in zip(jax.tree.leaves(room.fold(network)), jax.tree.leaves(load_weights(path)), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(
    "setting",
    [
        {"channels": (16, 32, 64, 95)},
        {"channels": (16, 32, 64)},
        {"bottlenecks": (1, 1, 1, -1)},
        {"context": 0},
    ],
)
def test_widths_that_make_no_network_are_refused(setting):
    with pytest.raises(InputError, match="context must be positive"):
        NetworkConfig(**setting)


def test_a_network_that_is_not_folded_is_refused_where_a_folded_one_is_needed(network):
    images = jnp.zeros((1, 32, 32))
    with pytest.raises(InputError, match="fold it first"):
        room.forward(network, images)
    with pytest.raises(InputError, match="no batch normalisations"):
        room.forward(fold(network), images, BatchStatistics())


def test_files_that_hold_no_such_network_are_refused(network, tmp_path):
    with pytest.raises(InputError, match="There is no"):
        load_weights(tmp_path / "none.safetensors")
    (tmp_path / "foreign.safetensors").write_bytes(b"PK\x03\x04 not weights")
    with pytest.raises(InputError, match="safetensors"):
        load_weights(tmp_path / "foreign.safetensors")
    narrow = initialise_network(jax.random.key(0), NetworkConfig(channels=(16, 16, 16, 16)))
    save_weights(tmp_path / "narrow.safetensors", narrow)
    with pytest.raises(InputError, match="widths"):
        load_weights(tmp_path / "narrow.safetensors")
