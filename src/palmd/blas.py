"""Limits linear algebra to one thread: palmd's matrices are small, and further threads only wait for one another.

OpenBLAS's threads spin while they wait and so take processor time from everything else; and the order of their sums
changes the last bits of results.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

_own_process = False  # whether this process belongs to palmd and has used one thread from its start
_VARIABLES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")


def one_thread_from_here() -> None:
    """Use one thread in this process and its children; call in palmd's own processes before loading array libraries."""
    global _own_process
    _own_process = True
    os.environ.update(dict.fromkeys(_VARIABLES, "1"))


@contextmanager
def one_thread() -> Iterator[None]:
    """One thread inside the context, as many as before afterwards; for functions called from other programs.

    Takes 30 µs. OpenBLAS's threads belong to the whole process: if several Python threads are inside at once, the first
    to enter removes them and restores them.
    """
    if _own_process:
        yield
        return
    with _libraries().limit(limits=1):
        yield


@functools.cache
def _libraries() -> ThreadpoolController:
    import numpy  # noqa: F401    # its bundled library can be limited once it is loaded
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")
