"""One thread for the linear algebra: palmd's matrices are small, and more threads only wait for one another.

OpenBLAS's threads spin while they wait, so that beside anything else that runs they take the time that they should
save; and the order of their sums changes the last bits.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

_alone = False  # whether this is a process of palmd's own, which begins with one thread and keeps to it
_VARIABLES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")


def one_thread_from_here() -> None:
    """For a process of palmd's own, before it loads an array library: no other threads, nor in what it starts."""
    global _alone
    _alone = True
    os.environ.update(dict.fromkeys(_VARIABLES, "1"))


@contextmanager
def one_thread() -> Iterator[None]:
    """One thread meanwhile, and then as many as before: for what is called from somebody else's program.

    Takes 30 µs. OpenBLAS's threads are the whole process's: where several of Python's threads are in here at once, the
    first one takes them away and gives them back.
    """
    if _alone:
        yield
        return
    with _libraries().limit(limits=1):
        yield


@functools.cache
def _libraries() -> ThreadpoolController:
    import numpy  # noqa: F401  # it brings a library of its own, which can be limited once it is loaded
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")
