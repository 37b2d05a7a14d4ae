"""Small recordings to read back."""

import cv2
import numpy as np
import pytest

from sfgs_jax.datasets import SyntheticRecording


@pytest.fixture(scope="session")
def room() -> SyntheticRecording:
    """A synthetic room of one small image size: each size compiles anew."""
    return SyntheticRecording(num_frames=5, width=80, height=60)


@pytest.fixture
def write_image():
    """Writes an RGB or depth array as an image file, with its folders."""

    def write(path, image: np.ndarray) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        if image.ndim == 3:
            image = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
        assert cv2.imwrite(str(path), image)

    return write


@pytest.fixture
def images(rng):
    """An RGB image and a depth image in 16-bit units from 1000 to 3000, of a given size."""

    def make(width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        rgb = rng.integers(0, 256, (height, width, 3), dtype=np.uint8)
        return rgb, rng.integers(1000, 3000, (height, width), dtype=np.uint16)

    return make
