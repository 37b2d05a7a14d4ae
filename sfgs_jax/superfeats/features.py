"""What a keypoint extractor returns, and what a matcher does."""

import equinox as eqx
from jaxtyping import Array, Bool, Float, Int


class Features(eqx.Module):
    """K keypoint slots of one image, the best first; slots that are not `valid` hold zeros.

    Attributes:
        keypoints: (K, 2) pixel (u, v), to sub-pixel; pixel centres lie at integers.
        scores: (K,) higher is better, comparable within one extractor only.
        descriptors: (K, D) of unit length, so that a dot product is the cosine similarity.
        valid: (K,) which slots hold a keypoint.
    """

    keypoints: Float[Array, "k 2"]
    scores: Float[Array, " k"]
    descriptors: Float[Array, "k d"]
    valid: Bool[Array, " k"]


class Matches(eqx.Module):
    """For each keypoint of image a its counterpart in image b, where there is one.

    Attributes:
        index_b: (K,) slot in image b; 0 where not `valid`.
        similarity: (K,) cosine of the two descriptors; 0 where not `valid`.
        valid: (K,) which keypoints of image a are matched.
    """

    index_b: Int[Array, " k"]
    similarity: Float[Array, " k"]
    valid: Bool[Array, " k"]
