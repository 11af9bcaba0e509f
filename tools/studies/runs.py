"""Executors for many independent runs: processes of this machine, or an existing Dask cluster.

The same function does the same work on either. Imports no array library, since a worker must set its number of threads
before it loads one.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from typing import TypeVar

from palmd import blas

CONNECT_S = 10.0

Task = TypeVar("Task")
Result = TypeVar("Result")


@contextmanager
def local(jobs: int) -> Iterator[Executor]:
    """An executor with `jobs` processes; on an exception they end at once, without finishing their runs."""
    context = multiprocessing.get_context("spawn")  # a forked child would inherit threads' locks and open files
    executor = ProcessPoolExecutor(jobs, context, _begin_worker)
    try:
        yield executor
        executor.shutdown()
    except BaseException:
        executor.shutdown(wait=False, cancel_futures=True)
        for process in multiprocessing.active_children():
            process.terminate()
        raise


@contextmanager
def cluster(address: str) -> Iterator[Executor]:
    """An executor on the cluster with its Dask scheduler at `address`; unfinished runs are cancelled on exit.

    Raises OSError if there is no scheduler, ValueError for an invalid address, ModuleNotFoundError without the extra
    `studies`. The workers need this version of palmd.
    """
    from distributed import Client

    with Client(address, timeout=CONNECT_S, set_as_default=False) as client:
        yield client.get_executor(pure=False)


def finished(
    executor: Executor,
    work: Callable[[Task], Result],
    failed: Callable[[Task, BaseException], Result],
    tasks: Iterable[Task],
) -> Iterator[Result]:
    """Results of `work` for each task, in the order in which they finish; `failed` gives those of tasks not run."""
    futures = {executor.submit(work, task): task for task in tasks}
    for future in as_completed(futures):
        error = future.exception()
        yield future.result() if error is None else failed(futures[future], error)


def _begin_worker() -> None:
    """Initialise a worker: one thread for linear algebra, end with the parent process."""
    blas.one_thread_from_here()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles a terminal's Ctrl-C
    threading.Thread(target=_die_with_parent, daemon=True).start()


def _die_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
