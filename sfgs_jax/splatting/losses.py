"""Image losses: L1 and SSIM, with masks."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

_RADIUS = 5
_SIGMA = 1.5
_C1 = 0.01**2
_C2 = 0.03**2


def l1(a: Float[Array, "H W *c"], b: Float[Array, "H W *c"], mask: Bool[Array, "H W"] | None = None) -> Array:
    """Mean absolute difference over pixels and channels.

    Args:
        a: (H, W) or (H, W, C) image.
        b: image of the same shape.
        mask: pixels that count; all where None. Where none counts the loss is 0. What the images
            hold elsewhere, NaN included, has no influence on the value or the gradients.

    Returns:
        Scalar of the images' type.
    """
    a, b = _masked(a, mask), _masked(b, mask)
    return _mean(jnp.abs(a - b), mask)


def ssim(
    a: Float[Array, "H W *c"], b: Float[Array, "H W *c"], mask: Bool[Array, "H W"] | None = None
) -> Array:
    """Structural similarity, the mean over pixels and channels; 1 for equal images.

    Windows are 11 x 11 Gaussians of sigma 1.5; pixels outside the image count as 0, so that any size
    has a value. The data range is 1.

    Args:
        a: (H, W) or (H, W, C) image, values in [0, 1].
        b: image of the same shape.
        mask: pixels whose windows count; all where None. Both images are taken as 0 elsewhere, so what
            they hold there, NaN included, has no influence. Where no pixel counts the result is 0.

    Returns:
        Scalar of the images' type.

    Source: Wang et al., Image quality assessment: from error visibility to structural similarity, 2004;
    padding as in 3D Gaussian Splatting (Kerbl et al. 2023).
    """
    # Channels first: the shifted slices of the blur are then contiguous rows.
    x, y = (jnp.moveaxis(jnp.atleast_3d(_masked(image, mask)), -1, 0) for image in (a, b))
    counts = jnp.ones(x.shape[1:], x.dtype) if mask is None else mask.astype(x.dtype)
    return _similarity(x, y, counts) / (x.shape[0] * jnp.maximum(jnp.sum(counts), 1))


@jax.custom_vjp
def _similarity(
    x: Float[Array, "c h w"], y: Float[Array, "c h w"], counts: Float[Array, "h w"]
) -> Float[Array, ""]:
    """Sum of the similarity over the channels and over the pixels that count."""

    # One channel at a time: the moments of three at once are no longer in the cache.
    def channel(images: tuple[Array, Array]) -> Array:
        return jnp.sum(counts * _Terms.of(*images).similarity)

    return jnp.sum(jax.lax.map(channel, (x, y)))


def _similarity_forward(x: Array, y: Array, counts: Array) -> tuple[Array, tuple[Array, Array]]:
    """The value is one number, so its gradient can be had at once, up to the factor that comes later."""

    def channel(images: tuple[Array, Array]) -> tuple[Array, Array, Array]:
        x, y = images
        terms = _Terms.of(x, y)
        d_moments = [counts * d for d in terms.gradients()]
        d_mean_x, d_mean_y, d_square, d_product = _blur(jnp.stack(d_moments))
        d_x = d_mean_x + 2 * x * d_square + y * d_product
        d_y = d_mean_y + 2 * y * d_square + x * d_product
        return jnp.sum(counts * terms.similarity), d_x, d_y

    values, d_x, d_y = jax.lax.map(channel, (x, y))
    return jnp.sum(values), (d_x, d_y)


_similarity.defvjp(
    _similarity_forward, lambda gradients, factor: (factor * gradients[0], factor * gradients[1], None)
)


class _Terms(eqx.Module):
    """The similarity (l₁ l₂) / (s₁ s₂) of every pixel's window, from the moments of the windows."""

    mean_x: Array
    mean_y: Array
    l1: Array
    l2: Array
    s1: Array
    s2: Array

    @staticmethod
    def of(x: Array, y: Array) -> "_Terms":
        mean_x, mean_y, square_x, square_y, product = _blur(jnp.stack([x, y, x * x, y * y, x * y]))
        means, squares = mean_x * mean_y, mean_x**2 + mean_y**2
        return _Terms(
            mean_x,
            mean_y,
            l1=2 * means + _C1,
            l2=2 * (product - means) + _C2,
            s1=squares + _C1,
            s2=square_x + square_y - squares + _C2,
        )

    @property
    def similarity(self) -> Array:
        return (self.l1 * self.l2) / (self.s1 * self.s2)

    def gradients(self) -> tuple[Array, Array, Array, Array]:
        """Derivatives by the means of x and of y, by either mean square, and by the mean product."""
        scale = 1 / (self.s1 * self.s2)
        cross = 2 * (self.l2 - self.l1) * scale
        own = -2 * self.similarity * (1 / self.s1 - 1 / self.s2)
        return (
            cross * self.mean_y + own * self.mean_x,
            cross * self.mean_x + own * self.mean_y,
            -self.similarity / self.s2,
            2 * self.l1 * scale,
        )


def _masked(image: Array, mask: Array | None) -> Array:
    return image if mask is None else jnp.where(_over_channels(mask, image), image, 0)


def _mean(values: Array, mask: Array | None) -> Array:
    if mask is None:
        return jnp.mean(values)
    mask = jnp.broadcast_to(_over_channels(mask, values), values.shape)
    count = jnp.sum(mask, dtype=values.dtype)
    return jnp.sum(jnp.where(mask, values, 0)) / jnp.maximum(count, 1)


def _over_channels(mask: Array, image: Array) -> Array:
    return mask.reshape(mask.shape + (1,) * (image.ndim - 2))


def _window() -> list[float]:
    weights = np.exp(-0.5 * (np.arange(-_RADIUS, _RADIUS + 1) / _SIGMA) ** 2)
    return (weights / weights.sum()).tolist()


def _blur_axis(image: Array, axis: int) -> Array:
    size = image.shape[axis]
    padding = [(0, 0)] * image.ndim
    padding[axis] = (_RADIUS, _RADIUS)
    padded = jnp.pad(image, padding)
    terms = (
        weight * jax.lax.slice_in_dim(padded, shift, shift + size, axis=axis)
        for shift, weight in enumerate(_window())
    )
    return sum(terms, start=jnp.zeros_like(image))


def _blur(images: Float[Array, "m H W"]) -> Float[Array, "m H W"]:
    """Each image with the window; symmetric, and zero outside, so that this is its own adjoint."""
    return _blur_axis(_blur_axis(images, 1), 2)
