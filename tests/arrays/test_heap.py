"""Free memory is given back."""

import sys
from pathlib import Path

import numpy as np
import pytest

from sfgs_jax.arrays import return_free_memory

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc, and needs the GNU C library")


def resident_mb() -> float:
    line = next(
        row for row in Path("/proc/self/status").read_text().splitlines() if row.startswith("RssAnon")
    )
    return int(line.split()[1]) / 1024


def test_memory_between_blocks_in_use_is_given_back():
    blocks = [np.ones(8192) for _ in range(2000)]
    kept = blocks[::50]
    blocks.clear()
    before = resident_mb()
    assert return_free_memory()
    assert resident_mb() < before - 60
    assert sum(block.sum() for block in kept) == 40 * 8192
