"""A map in the browser's form: covariances and colours instead of parameters."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float32, Int

from sfgs_jax.geometry import rotations_from_quaternions
from sfgs_jax.splatting import Gaussians, sh_to_rgb

_CLOSER = 1.3
"""Area of a sample over the whole map's."""


@dataclass(frozen=True)
class Splats:
    """Gaussians on the host, float32.

    Attributes:
        centres: metres.
        covariances: square metres.
        rgb: in [0, 1]; the mean colour over all directions.
        opacities: in [0, 1].
    """

    centres: Float32[np.ndarray, "n 3"]
    covariances: Float32[np.ndarray, "n 3 3"]
    rgb: Float32[np.ndarray, "n 3"]
    opacities: Float32[np.ndarray, "n 1"]

    def __len__(self) -> int:
        return len(self.centres)

    def __getitem__(self, chosen: Int[np.ndarray, " k"] | Bool[np.ndarray, " n"] | slice) -> "Splats":
        return Splats(
            self.centres[chosen], self.covariances[chosen], self.rgb[chosen], self.opacities[chosen]
        )


def splats_of(gaussians: Gaussians) -> Splats:
    """The Gaussians in use: covariance R S² Rᵀ from rotation and scales, colour from degree 0."""
    used = np.asarray(gaussians.valid)
    rotations = rotations_from_quaternions(np.asarray(gaussians.quaternions)[used])
    axes = rotations * np.exp(np.asarray(gaussians.log_scales, np.float64)[used])[:, None, :]
    logits = np.asarray(gaussians.opacity_logits, np.float64)[used]
    rgb = sh_to_rgb(np.asarray(gaussians.sh)[used, 0])
    return Splats(
        centres=np.asarray(gaussians.means, np.float32)[used],
        covariances=(axes @ axes.transpose(0, 2, 1)).astype(np.float32),
        rgb=np.clip(rgb, 0, 1).astype(np.float32),
        opacities=(0.5 * (1 + np.tanh(0.5 * logits)))[:, None].astype(np.float32),
    )


def sampled(splats: Splats, most: int) -> Splats:
    """A random sample of a map that is too large to be sent.

    The rest is enlarged to cover the same area, and a little more: a random sample has gaps.

    Args:
        splats: the map.
        most: number of Gaussians to keep.
    """
    count = len(splats)
    if count <= most:
        return splats
    kept = splats[_sample(count, most)]
    return Splats(
        kept.centres, kept.covariances * np.float32(_CLOSER * count / most), kept.rgb, kept.opacities
    )


def sampled_gaussians(gaussians: Gaussians, most: int) -> Gaussians:
    """The same sample as that of `sampled`, of the Gaussians in use.

    Args:
        gaussians: the map.
        most: number of Gaussians to keep.
    """
    used = np.flatnonzero(np.asarray(gaussians.valid))
    if len(used) <= most:
        return gaussians
    kept = jax.tree.map(lambda x: x[used[_sample(len(used), most)]], gaussians)
    larger = 0.5 * np.log(_CLOSER * len(used) / most)
    return replace(kept, log_scales=kept.log_scales + jnp.float32(larger))


def _sample(count: int, most: int) -> Int[np.ndarray, " k"]:
    return np.sort(np.random.default_rng(0).permutation(count)[:most])
