"""Memory that is free, given back to the system.

The GNU C library keeps what is freed between blocks in use for later. Compilers leave much of it: in a long
run as much as all the rest.
"""

import ctypes
import sys


def return_free_memory() -> bool:
    """Give the free pages of the heap back to the system; takes 0.1 s or more, and other threads go on.

    Returns:
        Whether there were any; False on systems without the GNU C library, whose heaps do so themselves.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    return trim is not None and bool(trim(0))
