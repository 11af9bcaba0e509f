"""What a process without rights asks of the kernel all the same."""

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
    """Size, policy, flags, nice, priority and the slice (ns) of the calling thread."""
    told = ctypes.create_string_buffer(48)
    assert ctypes.CDLL(None).syscall(SCHED_GETATTR[platform.machine()], 0, told, 48, 0) == 0
    return struct.unpack("=2IQiI3Q", told.raw)[:6]


@pytest.mark.skipif(platform.machine() not in SCHED_GETATTR, reason="its number of the call is not known here")
def test_where_no_priority_is_allowed_short_slices_are_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refused)
    told: list[str | tuple[int, ...] | None] = []

    def thread() -> None:
        told.extend((attributes(), realtime._prioritise(50), attributes()))

    one = threading.Thread(target=thread)
    one.start()
    one.join()
    before, missing, after = told
    assert isinstance(missing, str)
    assert "no real-time priority" in missing
    assert isinstance(before, tuple)
    assert isinstance(after, tuple)
    assert after[:5] == before[:5]  # an ordinary thread as nice as before
    if tuple(map(int, platform.release().split(".")[:2])) >= SLICES_SINCE:
        assert after[5] == round(realtime.SLICE_S * 1e9)


def test_the_collector_that_rests_while_a_daemon_starts_looks_after_the_loop() -> None:
    run = "import gc; from palmd.daemon.realtime import freeze_collector; gc.disable(); freeze_collector()"
    told = "; print(gc.isenabled(), gc.get_freeze_count() > 0)"
    said = subprocess.run([sys.executable, "-c", run + told], capture_output=True, text=True, check=True)
    assert said.stdout.split() == ["True", "True"]
