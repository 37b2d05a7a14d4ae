"""Threads of BLAS, which NumPy's and SciPy's linear algebra starts for itself."""

from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import ThreadpoolController


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let linear algebra on the host use one thread in the block.

    Its matrices are small. Its other threads spin while they wait for work, which takes the cores from
    compiled programs. Beside them two cores track a tenth fewer frames in real time. With one thread the sums
    do not depend on the number of cores, either.
    """
    with ThreadpoolController().limit(limits=1, user_api="blas"):
        yield
