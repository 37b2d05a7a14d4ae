"""ORB keypoints as `Features`, for comparison and for the paper's ablation."""

import cv2
import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import checked, require_least
from sfgs_jax.superfeats._features import Features, pack_features

_SCALE = 1.2
"""From one level of the pyramid to the next."""


@checked
def extract_orb(
    image: Float[np.ndarray, "h w"] | Float[np.ndarray, "h w 3"], *, max_keypoints: int = 1024
) -> Features:
    """ORB keypoints of an image of any size, on the host through OpenCV.

    The 256 bits of a descriptor become numbers of ±1/16, so it has unit length. A dot product is then
    1 - 2 h / 256 with h the Hamming distance, and `match` needs no other rule than for learned descriptors.

    Args:
        image: grey (H, W) or RGB (H, W, 3), in [0, 1].
        max_keypoints: slots of the result; an image without corners leaves all of them empty.

    Raises:
        InputError: the number of slots is negative.

    Source: Rublee et al., ORB: an efficient alternative to SIFT or SURF, ICCV 2011.
    """
    require_least(max_keypoints, 0, "max_keypoints of extract_orb")
    scaled = np.clip(np.rint(np.asarray(image, np.float32) * 255), 0, 255).astype(np.uint8)
    grey = cv2.cvtColor(scaled, cv2.COLOR_RGB2GRAY) if scaled.ndim == 3 else scaled
    found, bits = cv2.ORB.create(nfeatures=max_keypoints, scaleFactor=_SCALE).detectAndCompute(grey, None)
    if not found:
        return pack_features(np.zeros((0, 2)), np.zeros(0), np.zeros((0, 256)), capacity=max_keypoints)
    descriptors = (np.unpackbits(np.asarray(bits, np.uint8), axis=1) * np.float32(2) - 1) / 16
    scores = np.asarray([keypoint.response for keypoint in found])
    # OpenCV multiplies a pixel of the pyramid by its level's scale, and so takes the first pixels of all
    # levels for one place. Their borders coincide, not their centres.
    scales = np.asarray([_SCALE**keypoint.octave for keypoint in found], np.float32)
    pixels = np.asarray(cv2.KeyPoint.convert(found)) + (scales[:, None] - 1) / 2
    return pack_features(pixels, scores, descriptors, capacity=max_keypoints)
