"""The emulation itself: products are rounded wherever they stand, and only those at the default precision."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from tests.tf32 import at_tf32, default_products

HIGHEST = lax.Precision.HIGHEST


def plain(a, b):
    return a @ b


def inside_jit(a, b):
    return jax.jit(plain)(a, b)


def inside_loops(a, b):
    def step(carry, _):
        return lax.fori_loop(0, 1, lambda i, c: a @ b, carry), None

    return lax.scan(step, jnp.zeros_like(a @ b), None, length=2)[0]


def inside_while(a, b):
    return lax.while_loop(lambda s: s[0] < 1, lambda s: (s[0] + 1, a @ b), (0, jnp.zeros_like(a)))[1]


def inside_branches(a, b):
    return lax.cond(jnp.sum(a) < 1e9, plain, lambda a, b: jnp.zeros_like(a), a, b)


@jax.custom_jvp
def with_jvp(a, b):
    return a @ b


@jax.custom_vjp
def with_vjp(a, b):
    return a @ b


with_jvp.defjvp(lambda primals, tangents: (with_jvp(*primals), tangents[0]))
with_vjp.defvjp(lambda a, b: (a @ b, None), lambda _, g: (g, g))


def inside_checkpoint(a, b):
    return jax.checkpoint(plain)(a, b)


def in_a_derivative(a, b):
    return jax.grad(lambda x: jnp.sum((x @ b) * lax.stop_gradient(a)))(a).T @ jnp.eye(len(a))


def rounded(x):
    return np.asarray(lax.reduce_precision(x, exponent_bits=8, mantissa_bits=10), np.float64)


@pytest.fixture
def matrices(rng):
    return tuple(jnp.asarray(rng.normal(size=(6, 6)), jnp.float32) for _ in range(2))


@pytest.mark.parametrize(
    "function",
    [
        plain,
        inside_jit,
        inside_loops,
        inside_while,
        inside_branches,
        with_jvp,
        with_vjp,
        inside_checkpoint,
        jax.vmap(lambda row, b: row @ b, in_axes=(0, None)),
    ],
)
def test_operands_lose_their_lower_bits_wherever_the_product_stands(matrices, function):
    a, b = matrices
    np.testing.assert_allclose(at_tf32(function)(a, b), rounded(a) @ rounded(b), rtol=0, atol=2e-6)
    exact = np.asarray(a, np.float64) @ np.asarray(b, np.float64)
    assert np.abs(at_tf32(function)(a, b) - exact).max() > 1e-4
    assert default_products(function, a, b)


def test_products_of_a_derivative_are_rounded_too(matrices):
    a, b = matrices
    expected = rounded(rounded(a) @ rounded(b).T).T
    np.testing.assert_allclose(at_tf32(in_a_derivative)(a, b), expected, rtol=1e-3)
    assert len(default_products(in_a_derivative, a, b)) >= 2


def test_a_convolution_is_a_product(rng):
    image, kernel = (jnp.asarray(rng.normal(size=s), jnp.float32) for s in ((1, 1, 8, 8), (1, 1, 3, 3)))

    def convolved(image, kernel):
        return lax.conv(image, kernel, (1, 1), "SAME")

    expected = convolved(*(jnp.asarray(rounded(x), jnp.float32) for x in (image, kernel)))
    np.testing.assert_allclose(at_tf32(convolved)(image, kernel), expected, atol=1e-6)
    assert [p.primitive for p in default_products(convolved, image, kernel)] == ["conv_general_dilated"]


def test_products_that_ask_for_precision_keep_their_bits(matrices):
    def exact(a, b):
        return jnp.matmul(a, b, precision=HIGHEST)

    np.testing.assert_array_equal(at_tf32(exact)(*matrices), jax.jit(exact)(*matrices))
    assert not np.array_equal(at_tf32(exact, every=True)(*matrices), jax.jit(exact)(*matrices))
    assert not default_products(exact, *matrices)
    with jax.default_matmul_precision("highest"):
        assert not default_products(plain, *matrices)


def test_arguments_and_results_may_be_trees_with_static_parts(matrices):
    def tree(arguments, name):
        a, b = arguments
        return {"product": a @ b, "name": name, "sum": a + b}

    found = at_tf32(tree)(matrices, "kept")
    assert found["name"] == "kept"
    np.testing.assert_array_equal(found["sum"], matrices[0] + matrices[1])
    np.testing.assert_allclose(found["product"], rounded(matrices[0]) @ rounded(matrices[1]), atol=2e-6)
