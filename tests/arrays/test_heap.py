"""Free memory is kept for the next call, and given back when asked."""

import subprocess
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


PAGES_OF_SECOND_BLOCK = """
import resource
from sfgs_jax.arrays import keep_freed_memory

def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt

if {keep}:
    assert keep_freed_memory()
bytearray(100 << 20)
before = faults()
bytearray(100 << 20)
print(faults() - before)
"""


@pytest.mark.parametrize(("keep", "least", "most"), [(False, 20_000, 10**9), (True, 0, 2_000)])
def test_a_large_block_takes_the_pages_of_the_one_before(keep: bool, least: int, most: int):
    code = PAGES_OF_SECOND_BLOCK.format(keep=keep)
    taken = int(subprocess.check_output([sys.executable, "-c", code], text=True))
    assert least <= taken <= most
