"""Threads of BLAS, which NumPy's and SciPy's linear algebra starts for itself."""

from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import ThreadpoolController


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let linear algebra on the host use one thread in the block.

    Its matrices are small. Its other threads spin while they wait for work, and so take the cores from
    compiled programs: beside them two cores track a fifth fewer frames. With one thread the sums are the same
    on every machine, too.
    """
    with ThreadpoolController().limit(limits=1, user_api="blas"):
        yield
