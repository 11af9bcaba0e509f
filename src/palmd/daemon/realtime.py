"""Real-time settings of the process: priority, locked memory, garbage collector. Best effort, without privileges."""

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
"""FIFO priority; the next higher, 51, would be above the kernel's own interrupt threads."""

RIG_PRIORITY = 40
"""FIFO priority of an emulated rig: like hardware it does not wait for other load, but it must not delay the loop."""

SWITCH_INTERVAL_S = 0.05e-3
"""Longest time that a helper thread keeps the interpreter from the loop."""

LARGEST_CODE = 12 << 20
"""Bytes of a library's code up to which all of it is read in; of larger ones (linear algebra) only used pages."""

SLICE_S = 0.1e-3
"""Smallest time slice of an ordinary thread that the kernel accepts (from Linux 6.12 on)."""

_SCHED_SETATTR = {"x86_64": 314, "aarch64": 274, "riscv64": 274}
_SCHED_ATTR = struct.Struct("=2IQiI3Q")  # size, policy, flags, nice, priority, runtime, deadline, period

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_MADV_POPULATE_READ = 22
_PR_SET_TIMERSLACK = 29
_CAP_IPC_LOCK = 14


def prepare(priority: int = PRIORITY) -> list[str]:
    """Apply what the system allows, from the thread that will run the loop; returns what it does not allow."""
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    missing = [_prioritise(priority), _lock_memory(), _tighten_timers()]
    return [text for text in missing if text is not None]


def raise_helper_priority() -> None:
    """Give the calling helper thread a priority just below the loop's, if allowed.

    A running helper thread holds the interpreter. If it had ordinary priority, a busy machine could preempt it then,
    and the loop would wait for the interpreter until the machine is less busy.
    """
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(PRIORITY - 1))


def limits_command(right: str) -> str:
    """The command that grants this user a right permanently, from the next login on."""
    return f"echo '{user()} - {right}' | sudo tee -a /etc/security/limits.d/palmd.conf, and log in again"


def user() -> str:
    """Name of the user of this process."""
    try:
        return pwd.getpwuid(os.getuid()).pw_name
    except KeyError:
        return str(os.getuid())


def freeze_collector() -> None:
    """Exclude all present objects from garbage collection, then enable the collector. Call after the set-up."""
    gc.collect()
    gc.freeze()
    gc.enable()


def rss_mb() -> float:
    """Resident memory of this process (MB); NaN if the system does not report it."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return float("nan")
    return pages * resource.getpagesize() / 1e6


def _prioritise(priority: int) -> str | None:
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK  # child processes and ZeroMQ's threads keep ordinary priority
    try:
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    except OSError as error:
        _request_short_slices()
        how = limits_command(f"rtprio {priority}")
        return f"no real-time priority ({error.strerror}): run palmd as its systemd service, or: {how}"
    return None


def _request_short_slices() -> None:
    """Ask for shorter time slices and so lower latency among ordinary threads; needs no privilege.

    A thread with shorter slices has the earlier deadline and does not wait for the end of another thread's slice.
    """
    number = _SCHED_SETATTR.get(os.uname().machine)
    if number is not None:  # older kernels ignore the slice
        nice = os.getpriority(os.PRIO_PROCESS, 0)
        attributes = _SCHED_ATTR.pack(_SCHED_ATTR.size, os.SCHED_OTHER, 0, nice, 0, round(SLICE_S * 1e9), 0, 0)
        ctypes.CDLL(None).syscall(number, 0, attributes, 0)


def _lock_memory() -> str | None:
    """Lock present and future memory, if any amount may be locked; otherwise a later page could fail.

    Pages are locked when they are first touched: untouched thread stacks, library reserves and unused code amount to
    about 100 MB, and the first touch costs a microsecond. The loop's code must never wait for a disk, so it is read in
    now.
    """
    limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if limit != resource.RLIM_INFINITY and not _may_lock():
        return f"memory is not locked: run palmd as its systemd service, or: {limits_command('memlock unlimited')}"
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) != 0:
        return f"memory is not locked ({os.strerror(ctypes.get_errno())})"
    for begin, size in _code():
        libc.madvise(ctypes.c_void_p(begin), ctypes.c_size_t(size), _MADV_POPULATE_READ)  # may fail on older kernels
    return None


def _code() -> list[tuple[int, int]]:
    """Address and size of the code of each library except the largest."""
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
    """Set the timer slack to 1 ns; the default wakes ordinary processes 50 µs late to save power."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0) != 0:
        return f"timer slack stays as it is ({os.strerror(ctypes.get_errno())})"
    return None
