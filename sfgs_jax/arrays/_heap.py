"""Memory that is free: what is kept for the next call, and what is given back to the system.

The GNU C library gives a block above 32 MiB back as soon as it is free. A compiled step whose scratch is
larger then takes its pages anew in each call, which is up to a fifth of its time. Smaller blocks that are
freed between others in use are kept for later. Compilers leave much of it: in a long run as much as all the
rest.
"""

import ctypes
import sys

_TRIM_THRESHOLD, _MMAP_MAX = -1, -4
"""Parameters of `mallopt`, by their numbers in `malloc.h`."""


def keep_freed_memory(megabytes: int = 256) -> bool:
    """Keep freed blocks of any size for later ones, from now on in the whole process.

    Args:
        megabytes: free memory at the end of a heap above which it is given back, MiB.

    Returns:
        Whether the C library takes such settings; False without the GNU C library.
    """
    settings = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if settings is None:
        return False
    return bool(settings(_MMAP_MAX, 0)) and bool(settings(_TRIM_THRESHOLD, megabytes << 20))


def return_free_memory() -> bool:
    """Give the free pages of the heap back to the system; takes 0.1 s or more, and other threads go on.

    Returns:
        Whether there were any; False on systems without the GNU C library, whose heaps do so themselves.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    return trim is not None and bool(trim(0))
