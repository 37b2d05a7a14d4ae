"""Room for files that stay open: each file that is mapped into memory is one."""

import sys
from functools import cache

_WANTED = (1 << 16, 10240)
"""Open files to ask for. The second number is all that macOS allows."""


@cache
def allow_open_files() -> None:
    """Raise the process's own limit on open files, where the system's leaves room for that.

    Usual ones are 1024 on Linux and 256 on macOS, fewer than a long run has images on disk. Done once.
    """
    if sys.platform == "win32":  # has no such limit
        return
    import resource

    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    for wanted in _WANTED:
        soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        most = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
        if soft == resource.RLIM_INFINITY or soft >= most:
            return
        try:
            resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
        except (ValueError, OSError):
            continue
        return
