"""Image losses: L1 and SSIM, with masks."""

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
    mean_x, mean_y, mean_xx, mean_yy, mean_xy = _blur(jnp.stack([x, y, x * x, y * y, x * y]))
    product, squares = mean_x * mean_y, mean_x**2 + mean_y**2
    similarity = ((2 * product + _C1) * (2 * (mean_xy - product) + _C2)) / (
        (squares + _C1) * (mean_xx + mean_yy - squares + _C2)
    )
    return _mean(jnp.moveaxis(similarity, 0, -1), mask)


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


@jax.custom_vjp
def _blur(images: Float[Array, "*c H W"]) -> Float[Array, "*c H W"]:
    # Without the barriers XLA fuses the passes with their neighbours and repeats them per use.
    rows = _blur_axis(jax.lax.optimization_barrier(images), images.ndim - 2)
    return jax.lax.optimization_barrier(_blur_axis(jax.lax.optimization_barrier(rows), images.ndim - 1))


# The window is symmetric and the padding is zero, so the blur is its own adjoint. The automatic
# transpose of 22 slices is 22 padded images, which costs several times more.
_blur.defvjp(lambda images: (_blur(images), None), lambda _, cotangent: (_blur(cotangent),))
