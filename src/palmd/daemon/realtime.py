"""Real-time manners of the process: priority, locked memory, quiet collector. All best effort, no privilege needed."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import pwd
import resource
import struct
import sys
from pathlib import Path

PRIORITY = 50
"""FIFO priority: above the kernel's own interrupt threads would be 51 and more."""

RIG_PRIORITY = 40
"""That of an emulated rig: hardware does not wait for what else a machine has to do; nor does it hold up the loop."""

SWITCH_INTERVAL_S = 0.05e-3
"""For how long at most a helper thread keeps the interpreter from the loop."""

LARGEST_CODE = 12 << 20
"""Bytes of a library's code up to which all of it is read in: of the linear algebra's only what has been used is."""

SLICE_S = 0.1e-3
"""The least a kernel takes (from Linux 6.12 on) for an ordinary thread's time at a stretch."""

_SCHED_SETATTR = {"x86_64": 314, "aarch64": 274, "riscv64": 274}
_SCHED_ATTR = struct.Struct("=2IQiI3Q")  # size, policy, flags, nice, priority, runtime, two of deadlines

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_MADV_POPULATE_READ = 22
_PR_SET_TIMERSLACK = 29
_CAP_IPC_LOCK = 14


def prepare(priority: int = PRIORITY) -> list[str]:
    """Do what the system allows, from the thread that will run the loop; return what it did not, in words."""
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    missing = [_prioritise(priority), _lock_memory(), _tighten_timers()]
    return [text for text in missing if text is not None]


def accompany() -> None:
    """Give the calling helper thread nearly the loop's priority, where that is allowed.

    While it runs it has the interpreter. Were it an ordinary thread, a busy machine could take the processor from it
    then, and the loop would wait for the interpreter until that machine has time again.
    """
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(PRIORITY - 1))


def allowing(right: str) -> str:
    """The command that gives this user a right for good, from when they log in again."""
    return f"echo '{user()} - {right}' | sudo tee -a /etc/security/limits.d/palmd.conf, and log in again"


def user() -> str:
    """Whose rights these are."""
    try:
        return pwd.getpwuid(os.getuid()).pw_name
    except KeyError:
        return str(os.getuid())


def freeze_collector() -> None:
    """Take everything made so far out of the collector's sight, and let it begin. Once all is set up."""
    gc.collect()
    gc.freeze()
    gc.enable()


def rss_mb() -> float:
    """Resident memory of this process; NaN where the system does not tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return float("nan")
    return pages * resource.getpagesize() / 1e6


def _prioritise(priority: int) -> str | None:
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK  # children stay ordinary, and so do ZeroMQ's threads
    try:
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    except OSError as error:
        _want_little_at_a_time()
        how = allowing(f"rtprio {priority}")
        return f"no real-time priority ({error.strerror}): run palmd as its systemd service, or: {how}"
    return None


def _want_little_at_a_time() -> None:
    """Ask to be let in sooner among ordinary threads, for less time at a stretch: needs no right.

    Who asks for shorter slices has the earlier deadline, and does not wait until another's slice has ended.
    """
    number = _SCHED_SETATTR.get(os.uname().machine)
    if number is not None:  # an older kernel ignores the slice
        nice = os.getpriority(os.PRIO_PROCESS, 0)
        attributes = _SCHED_ATTR.pack(_SCHED_ATTR.size, os.SCHED_OTHER, 0, nice, 0, round(SLICE_S * 1e9), 0, 0)
        ctypes.CDLL(None).syscall(number, 0, attributes, 0)


def _lock_memory() -> str | None:
    """Lock what is there and what comes; without the right to do so for good, a later page must not fail.

    What has never been touched is locked once it is: of the stacks of threads, of the memory that libraries set aside
    and of code for other uses that is a hundred megabytes, whose first touch costs a microsecond. But the loop's code
    shall never wait for a disk, so that is read in now.
    """
    limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if limit != resource.RLIM_INFINITY and not _may_lock():
        return f"memory is not locked: run palmd as its systemd service, or: {allowing('memlock unlimited')}"
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) != 0:
        return f"memory is not locked ({os.strerror(ctypes.get_errno())})"
    for begin, size in _code():
        libc.madvise(ctypes.c_void_p(begin), ctypes.c_size_t(size), _MADV_POPULATE_READ)  # an older kernel refuses
    return None


def _code() -> list[tuple[int, int]]:
    """Address and size of the code of each library, but of the largest."""
    found = []
    with contextlib.suppress(OSError):
        for line in Path("/proc/self/maps").read_text(encoding="utf-8", errors="replace").splitlines():
            span, rights, *_, path = line.split(maxsplit=5)
            begin, end = (int(each, 16) for each in span.split("-"))
            if "x" in rights and path.startswith("/") and end - begin <= LARGEST_CODE:
                found.append((begin, end - begin))
    return found


def _may_lock() -> bool:
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii")
    except OSError:
        return False
    effective = next((line for line in status.splitlines() if line.startswith("CapEff:")), "CapEff: 0")
    return bool(int(effective.split()[1], 16) >> _CAP_IPC_LOCK & 1)


def _tighten_timers() -> str | None:
    """Sleep to the microsecond: ordinary processes wake 50 µs late, to save power."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0) != 0:
        return f"timer slack stays as it is ({os.strerror(ctypes.get_errno())})"
    return None
