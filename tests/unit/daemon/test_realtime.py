"""Scheduling that a process without privileges still requests from the kernel."""

from __future__ import annotations

import ctypes
import os
import platform
import struct
import subprocess
import sys
import threading

import pytest

from palmd.daemon import realtime

SCHED_GETATTR = {"x86_64": 315, "aarch64": 275, "riscv64": 275}
SLICES_SINCE = (6, 12)


def attributes() -> tuple[int, ...]:
    """Size, policy, flags, nice, priority and slice (ns) of the calling thread."""
    buffer = ctypes.create_string_buffer(48)
    assert ctypes.CDLL(None).syscall(SCHED_GETATTR[platform.machine()], 0, buffer, 48, 0) == 0
    return struct.unpack("=2IQiI3Q", buffer.raw)[:6]


@pytest.mark.skipif(platform.machine() not in SCHED_GETATTR, reason="its number of the call is not known here")
def test_without_permission_for_priority_short_slices_are_requested(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refused)
    measured: list[str | tuple[int, ...] | None] = []

    def thread() -> None:
        measured.extend((attributes(), realtime._prioritise(50), attributes()))

    one = threading.Thread(target=thread)
    one.start()
    one.join()
    before, missing, after = measured
    assert isinstance(missing, str)
    assert "no real-time priority" in missing
    assert isinstance(before, tuple)
    assert isinstance(after, tuple)
    assert after[:5] == before[:5]  # still an ordinary thread of the same niceness
    if tuple(map(int, platform.release().split(".")[:2])) >= SLICES_SINCE:
        assert after[5] == round(realtime.SLICE_S * 1e9)


def test_garbage_collection_pauses_during_start_up_and_runs_after_it() -> None:
    run = "import gc; from palmd.daemon.realtime import freeze_collector; gc.disable(); freeze_collector()"
    printing = "; print(gc.isenabled(), gc.get_freeze_count() > 0)"
    said = subprocess.run([sys.executable, "-c", run + printing], capture_output=True, text=True, check=True)
    assert said.stdout.split() == ["True", "True"]
