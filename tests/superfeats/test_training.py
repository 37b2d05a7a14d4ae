"""Training steps on a made-up batch, on one device and on four."""

import os
import subprocess
import sys
from dataclasses import fields, replace

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.superfeats.network import (
    DESCRIPTOR_SIZE,
    NetworkConfig,
    NormalisedConvolution,
    fold,
    initialise_network,
)
from sfgs_jax.superfeats.training import (
    Batch,
    LossWeights,
    ViewConfig,
    evaluate,
    initial_state,
    train_step,
    unit,
)

SMALL = NetworkConfig(channels=(8, 16, 16, 16), bottlenecks=(1, 1, 1, 1), context=8)
OPTIMISER = optax.adam(3e-3)
PAIRS = 4  # a batch that four devices can share; the same in all tests, for each number is a program
SIZE = 64
CELLS = SIZE // 8


@pytest.fixture(autouse=True)
def _promotion_as_optax_needs_it():
    with jax.numpy_dtype_promotion("standard"):
        yield


def made_up_batch(rng: np.random.Generator) -> Batch:
    """Second views are the first ones, shifted by a cell."""
    images = rng.normal(size=(PAIRS, SIZE, SIZE + 8)).astype(np.float32)
    views = np.stack([images[..., 8:], images[..., :-8]], 1)
    steps = 8 * np.arange(1, CELLS - 2)
    points = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2).astype(np.float32) + 4
    descriptors = rng.normal(size=(PAIRS, 2, CELLS, CELLS, DESCRIPTOR_SIZE)).astype(np.float32)
    heat = rng.random((PAIRS, 2, CELLS, CELLS, 65)).astype(np.float32)
    return Batch(
        images=jnp.asarray(views),
        heat=jnp.asarray(heat / heat.sum(-1, keepdims=True)),
        descriptors=unit(jnp.asarray(descriptors)),
        reliability=jnp.asarray(rng.random((PAIRS, 2, CELLS, CELLS)), jnp.float32),
        labelled=jnp.ones((PAIRS, 2, CELLS, CELLS)),
        points=jnp.tile(np.stack([points, points + np.array([8, 0], np.float32)]), (PAIRS, 1, 1, 1)),
        seen=jnp.ones((PAIRS, len(points)), bool),
        H_b_a=jnp.tile(jnp.eye(3).at[0, 2].set(8.0), (PAIRS, 1, 1)),
        planar=jnp.ones(PAIRS),
        hidden=jnp.zeros((PAIRS, 2, SIZE, SIZE), bool),
    )


def run(batch: Batch, steps: int, weights: LossWeights, sharding: jax.sharding.Sharding | None = None):
    state = initial_state(initialise_network(jax.random.key(0), SMALL), OPTIMISER)
    state = jax.device_put(state, sharding)
    history = []
    for _ in range(steps):
        state, figures = train_step(state, batch, optimiser=OPTIMISER, weights=weights)
        history.append({name: float(value) for name, value in figures.items()})
    return state, history


def test_training_on_one_batch_learns_it(rng):
    batch = made_up_batch(rng)
    state, history = run(batch, 40, LossWeights())
    assert history[-1]["loss"] < 0.7 * history[0]["loss"]
    assert history[-1]["accuracy"] > 0.9
    assert int(state.step) == 40
    assert evaluate(fold(state.network), batch, weights=LossWeights())["accuracy"] > 0.5


def test_a_loss_left_out_is_still_measured_but_not_followed(rng):
    names = [each.name for each in fields(LossWeights)]
    weights = LossWeights(**(dict.fromkeys(names, 0.0) | {"hinge": 1.0, "contrast": 2.0}))
    _, (figures, _) = run(made_up_batch(rng), 2, weights)
    assert figures["loss"] == pytest.approx(figures["hinge"] + 2 * figures["contrast"], rel=1e-6)
    assert min(figures["hinge"], figures["contrast"]) > 0
    assert set(figures) == {"loss", "accuracy", *names}


def test_keypoints_of_pairs_that_share_no_plane_are_not_reprojected(rng):
    batch = made_up_batch(rng)
    network = fold(initialise_network(jax.random.key(0), SMALL))

    def reprojection(planar, shift) -> float:
        changed = replace(batch, planar=jnp.asarray(planar), H_b_a=batch.H_b_a.at[1, 0, 2].add(shift))
        return float(evaluate(network, changed, weights=LossWeights())["reprojection"])

    without = [1.0, 0.0, 1.0, 1.0]
    assert reprojection(without, 0.0) == reprojection(without, 3.0)
    assert reprojection([1.0] * PAIRS, 0.0) != reprojection([1.0] * PAIRS, 3.0)
    assert reprojection([0.0] * PAIRS, 0.0) == 0


def test_statistics_follow_the_batches(rng):
    batch = made_up_batch(rng)
    state, _ = run(batch, 3, LossWeights())
    before = initialise_network(jax.random.key(0), SMALL).levels[0].reduce
    after = state.network.levels[0].reduce
    assert isinstance(before, NormalisedConvolution)
    assert isinstance(after, NormalisedConvolution)
    assert not np.allclose(after.mean, before.mean)
    assert not np.allclose(after.variance, before.variance)


SHARED_BATCH = """
import sys
sys.path.insert(0, "tests/superfeats")
import jax, numpy as np
from jax.sharding import AxisType, NamedSharding, PartitionSpec
from test_training import LossWeights, made_up_batch, run
assert jax.device_count() == 4
jax.config.update("jax_numpy_dtype_promotion", "standard")
mesh = jax.make_mesh((4,), ("data",), axis_types=(AxisType.Auto,))
batch = jax.device_put(
    made_up_batch(np.random.default_rng(0)), NamedSharding(mesh, PartitionSpec("data"))
)
# The state is on all devices from the first step on, as it is after it: one program does for all steps.
history = run(batch, 3, LossWeights(), NamedSharding(mesh, PartitionSpec()))[1]
print(*(entry["loss"] for entry in history))
"""


def test_four_devices_give_the_loss_of_one():
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count=4"
    environment = {**os.environ, "XLA_FLAGS": flags}
    done = subprocess.run(
        [sys.executable, "-c", SHARED_BATCH], env=environment, capture_output=True, text=True, check=True
    )
    shared = [float(loss) for loss in done.stdout.split()]
    _, history = run(made_up_batch(np.random.default_rng(0)), 3, LossWeights())
    np.testing.assert_allclose(shared, [entry["loss"] for entry in history], rtol=2e-4)


def test_settings_out_of_range_are_refused():
    with pytest.raises(InputError, match="must not be negative"):
        LossWeights(heat=-1.0)
    for scale in ((0.0, 1.0), (1.5, 0.5)):
        with pytest.raises(InputError, match="0 < least scale"):
            ViewConfig(scale=scale)
    with pytest.raises(InputError, match="inside out"):
        ViewConfig(perspective=0.5)


def test_the_library_alone_brings_in_no_optimiser():
    command = "import sys, sfgs_jax; sys.exit('optax' in sys.modules)"
    subprocess.run([sys.executable, "-c", command], check=True)
