"""Many independent runs: on this machine's processors, or on a Dask cluster that is already there.

Both are executors, so that the same function does the same work on either. Imports no array library, since a
worker must be told how many threads to use before it loads one.
"""

from __future__ import annotations

import functools
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
    """So many processes of this machine; left by an exception, they end at once and leave their runs undone."""
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
    """The cluster whose Dask scheduler is at `address`; what is undone when it is left is taken back.

    Raises OSError when nobody answers there, ValueError for what is no address, ModuleNotFoundError without the
    extra `studies`. Its workers need this version of palmd.
    """
    from distributed import Client

    with Client(address, timeout=CONNECT_S, set_as_default=False) as client:
        yield client.get_executor(pure=False)


def with_failures(
    failed: Callable[[Task, BaseException], Result],
) -> Callable[[Callable[[Task], Result]], Callable[[Task], Result]]:
    """For what does a task: where it raises, `failed` speaks for it, in whichever process that is."""

    def around(work: Callable[[Task], Result]) -> Callable[[Task], Result]:
        @functools.wraps(work)
        def done(task: Task) -> Result:
            try:
                return work(task)
            except Exception as error:
                return failed(task, error)

        return done

    return around


def finished(
    executor: Executor,
    work: Callable[[Task], Result],
    failed: Callable[[Task, BaseException], Result],
    tasks: Iterable[Task],
) -> Iterator[Result]:
    """What `work` gives for each task, in the order in which they finish; `failed` speaks for what could not run."""
    futures = {executor.submit(work, task): task for task in tasks}
    for future in as_completed(futures):
        error = future.exception()
        yield future.result() if error is None else failed(futures[future], error)


def _begin_worker() -> None:
    """A worker's first act: one thread for its linear algebra, and no life of its own."""
    blas.one_thread_from_here()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal's Ctrl-C is the parent's to deal with
    threading.Thread(target=_die_with_parent, daemon=True).start()


def _die_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
