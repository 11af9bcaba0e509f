"""The smoother's process: it answers, never blocks the loop, ends with its parent and is restarted."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

import msgpack
import numpy as np
import pytest
from simulated import Run, simulated

from palmd import blas
from palmd.daemon import smoothing, worker
from palmd.daemon.smoothing import SmootherProcess
from palmd.events import Improvement, PadLift
from palmd.observer.incremental import IncrementalSmoother
from palmd.observer.smoothing import Session
from palmd.system.description import RigDescription
from palmd.system.pivot import PivotRig
from palmd.system.three_palms import ThreePalmsRig
from palmd.system.vibration import Vibration

PATIENCE_S = 60.0
SESSION = Session(1, 0.0)


@pytest.fixture(scope="module")
def run() -> Run:
    return simulated("nominal", 107, 3.0)


@pytest.fixture
def process(run: Run) -> Iterator[SmootherProcess]:
    process = SmootherProcess(run.rig)
    yield process
    process.close()


def number(process: SmootherProcess) -> int:
    return process._process._process.pid


def wait_for(process: SmootherProcess, run: Run) -> Improvement:
    """Submits the whole run and ticks until an improvement about its end comes back."""
    begun = time.monotonic()
    process.submit(run.events[-1].t_sample, SESSION, run.events)
    while time.monotonic() - begun < PATIENCE_S:
        t = run.events[-1].t_sample + time.monotonic() - begun
        process.submit(t, SESSION, [])
        if (improvement := process.collect(t)) is not None:
            return improvement
        time.sleep(0.01)
    raise AssertionError("no improvement came")


def test_the_process_answers_as_the_smoother_does(process: SmootherProcess, run: Run) -> None:
    smoother = IncrementalSmoother(run.rig)
    smoother.add(SESSION, run.events)
    with blas.one_thread():  # as in the process: several threads add in another order
        wanted = smoother.answer()
    got = wait_for(process, run)
    assert got.t == wanted.t
    np.testing.assert_allclose(got.x, wanted.x, rtol=1e-9)
    np.testing.assert_allclose(got.P, wanted.P, rtol=1e-6)
    assert (got.frame, got.established) == (wanted.frame, wanted.established)
    assert np.array_equal(got.touched, wanted.touched)


def test_every_kind_of_event_is_transferred_unchanged(run: Run) -> None:
    for event in (run.events[0], run.events[5], PadLift(1.5, 2)):
        assert smoothing.unpacked(smoothing.packed(event)) == event


def test_submitting_never_waits_for_a_stopped_process(process: SmootherProcess, run: Run) -> None:
    os.kill(number(process), signal.SIGSTOP)
    try:
        for tick in range(12 * smoothing.HIGH_WATER):
            process.submit(tick * smoothing.BATCH_S * 1.01, SESSION, run.events[:8])
            assert process.collect(0.0) is None
    finally:
        os.kill(number(process), signal.SIGCONT)
    assert process.dropped > 0


def test_a_killed_process_is_restarted(process: SmootherProcess, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker, "RESTART_S", 0.0)
    process._process._process.kill()
    process._process._process.wait()
    process.tend(time.monotonic())
    assert process.starts == 2
    wait_for(process, run)


def test_the_process_ends_with_its_parent(tmp_path: Path) -> None:
    parent = textwrap.dedent(
        """
        import os, sys
        from palmd.daemon.smoothing import SmootherProcess
        from palmd.system.description import RigDescription
        process = SmootherProcess(RigDescription())
        print(process._process._process.pid, flush=True)
        os.kill(os.getpid(), 9)
        """
    )
    done = subprocess.run([sys.executable, "-c", parent], capture_output=True, text=True, check=False)
    child = int(done.stdout)
    begun = time.monotonic()
    while Path(f"/proc/{child}/stat").exists() and time.monotonic() - begun < PATIENCE_S:
        if Path(f"/proc/{child}/stat").read_text(encoding="ascii").split()[2] == "Z":
            break
        time.sleep(0.1)
    else:
        assert not Path(f"/proc/{child}").exists()


def test_closing_ends_the_process_at_once(run: Run) -> None:
    process = SmootherProcess(run.rig)
    begun = time.monotonic()
    process.close()
    assert process._process._process.poll() is not None
    assert time.monotonic() - begun < 2 * worker.CLOSE_S + 1.0
    assert not Path(process._process._folder.name).exists()


@pytest.mark.parametrize("others_s", [0.0, 0.1, 5.0])
def test_the_process_pauses_to_leave_others_their_share_of_the_processor(
    monkeypatch: pytest.MonkeyPatch, others_s: float
) -> None:
    """An answer costs a second of the processor and `others_s` go to others anyway; pauses make up the rest."""
    paused_s = max(1.0 / smoothing.SHARE - 1.0 - others_s, 0.0)
    clock = Clock(others_s)
    monkeypatch.setattr(smoothing, "worker_socket", clock.worker_socket)
    monkeypatch.setattr(smoothing, "time", clock)
    with pytest.raises(Clock.OverError):
        smoothing.work("", lambda *_: None, clock.answer, list, lambda: 0.1)
    first, second, *_ = clock.answered
    assert second - (first + 1.0 + others_s) == pytest.approx(paused_s, abs=0.06)


def test_memory_is_returned_after_an_answer_and_not_during_one(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, given = Clock(0.0), list[float]()
    monkeypatch.setattr(smoothing, "worker_socket", clock.worker_socket)
    monkeypatch.setattr(smoothing, "time", clock)
    monkeypatch.setattr(smoothing, "release_memory", lambda: given.append(clock.t))
    for said in (None, [1.0]):
        given.clear()
        clock.said, clock.waited = said, 0
        with pytest.raises(Clock.OverError):
            smoothing.work("", lambda *_: None, clock.answer, list, lambda: 0.1)
        assert given == ([] if said is None else clock.sent)


class Clock:
    """Time, and a loop that submits events every 50 ms, for five seconds of waiting."""

    class OverError(Exception):
        """The loop has ended."""

    def __init__(self, others_s: float) -> None:
        self.t = self.spent = 0.0
        self.answered: list[float] = []
        self.sent: list[float] = []
        self.said: list[float] | None = None
        self._others_s, self.waited = others_s, 0

    def monotonic(self) -> float:
        return self.t

    def process_time(self) -> float:
        return self.spent

    @contextmanager
    def worker_socket(self, *_: object) -> Iterator[Clock]:
        yield self

    def recv(self) -> bytes:
        self.t += 0.05
        self.waited += 1
        if self.waited > 100:
            raise self.OverError
        return msgpack.packb([[]])

    def poll(self, _timeout: int) -> int:
        return 0

    def send(self, _message: bytes) -> None:
        self.sent.append(self.t)

    def answer(self) -> list[float] | None:
        self.answered.append(self.t)
        self.t += 1.0 + self._others_s
        self.spent += 1.0
        return self.said


@pytest.mark.parametrize("kind", [RigDescription, PivotRig, ThreePalmsRig])
def test_a_rig_is_transferred_unchanged(kind: type) -> None:
    rig = kind(vibration=Vibration("unknown", speed=0.012, speed_sd=0.001))
    assert smoothing.rig_from_json(json.dumps(asdict(rig)), kind) == rig
