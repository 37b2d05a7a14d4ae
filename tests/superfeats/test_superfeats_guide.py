"""The guide's example runs."""

import re
from pathlib import Path

import numpy as np

GUIDE = Path(__file__).parents[2] / "docs" / "superfeats.md"


def test_the_example_matches_a_shifted_image():
    found: dict = {}
    for example in re.findall(r"```python\n(.*?)```", GUIDE.read_text(), re.DOTALL):
        exec(example, found)
    shift = np.asarray(found["pixels_a"] - found["pixels_b"])
    assert len(shift) > 20
    np.testing.assert_allclose(np.median(shift, axis=0), [8, 0], atol=0.3)
