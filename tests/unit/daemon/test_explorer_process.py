"""The explorer's process: it gives the same answers as without one, never blocks the loop, and is restarted."""

from __future__ import annotations

import math
import os
import pickle
import signal
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from palmd.config.plans import ExploreGoal
from palmd.config.three_palms import ThreePalmsLimitsConfig, TiltGoal
from palmd.config.two_palms import LimitsConfig
from palmd.daemon import worker
from palmd.daemon.exploration_requests import Decider, ExplorationAnswer, ExplorationTask, Question
from palmd.daemon.explorer_process import HIGH_WATER, ExplorerProcess
from palmd.daemon.three_palms_system import DECIDER
from palmd.motion.decisions import UnderWay
from palmd.motion.limits import MotionLimits
from palmd.motion.segments import Move
from palmd.motion.three_palms import TiltLimits
from palmd.system.description import RigDescription
from palmd.system.three_palms import ThreePalmsRig

PATIENCE_S = 60.0
FEW = HIGH_WATER // 2
RIG = RigDescription()
HERE = (0.8, 1.6)
TASK = ExplorationTask(3, ExploreGoal(), MotionLimits.from_config(LimitsConfig(), pad_length=0.0555))


def question(t: float) -> Question:
    """A question that is answered by rocking, which needs no object."""
    return Question(t, TASK, None, UnderWay(Move(HERE, HERE, 0.0), 1.0))


@pytest.fixture(scope="module")
def process() -> Iterator[ExplorerProcess]:
    """One process for several tests, because its start takes seconds of the processor."""
    process = ExplorerProcess(RIG)
    process.prepare()
    yield process
    process.close()


def wait_for(process: ExplorerProcess) -> ExplorationAnswer:
    """Asks until an answer comes."""
    begun = time.monotonic()
    while time.monotonic() - begun < PATIENCE_S:
        t = time.monotonic() - begun
        process.ask(question(t))
        if (answer := process.collect(t)) is not None:
            return answer
        time.sleep(0.02)
    raise AssertionError("no answer came")


def test_the_process_decides_as_the_decider_does(process: ExplorerProcess) -> None:
    got = wait_for(process)
    wanted = Decider(RIG).answer(question(got.t))
    assert (got.run, got.after, got.object_count) == (wanted.run, wanted.after, wanted.object_count)
    assert (got.decision.kind, got.decision.move) == (wanted.decision.kind, wanted.decision.move)
    assert got.decision.move.start == HERE


def test_an_unknown_object_is_rocked_only_in_safe_poses() -> None:
    decider, far = Decider(RIG), (math.radians(125.0), math.radians(45.0))
    moves = [Move(far, far, 0.0)]
    while len(moves) < 10:
        move = decider.answer(Question(0.0, TASK, None, UnderWay(moves[-1], 1.0))).decision.move
        assert move is not None
        moves.append(move)
    back, rocked = moves[1:7], moves[7:]
    assert all(move.end[0] < move.start[0] for move in back)  # palm 1 returns step by step
    assert max(abs(move.end[0] - back[-1].end[0]) for move in rocked) == pytest.approx(math.radians(6.0))


def test_the_process_starts_once_and_only_when_needed() -> None:
    process = ExplorerProcess(RIG)
    process.ask(question(0.0))
    assert process.collect(0.0) is None
    assert process.starts == 0
    process.prepare()
    process.prepare()
    assert process.starts == 1
    process.close()


def test_a_stopped_process_never_blocks_and_then_answers_the_newest_question(process: ExplorerProcess) -> None:
    wait_for(process)
    number = process._process._process.pid
    os.kill(number, signal.SIGSTOP)
    begun = time.monotonic()
    try:
        for tick in range(FEW):
            process.ask(question(1000.0 + tick))
        time.sleep(0.1)
    finally:
        os.kill(number, signal.SIGCONT)
    answered: list[float] = []
    while answered[-1:] != [1000.0 + FEW - 1] and time.monotonic() - begun < PATIENCE_S:
        answered += [pickle.loads(message).t for message in process._process.received()]
        time.sleep(0.01)
    assert answered[-1] == 1000.0 + FEW - 1
    assert len(answered) < FEW
    os.kill(number, signal.SIGSTOP)
    begun = time.monotonic()
    for _ in range(100 * HIGH_WATER):
        process.ask(question(0.0))
    assert time.monotonic() - begun < 5.0
    os.kill(number, signal.SIGCONT)


def test_a_killed_process_is_restarted_with_its_task(process: ExplorerProcess, monkeypatch: pytest.MonkeyPatch) -> None:
    wait_for(process)
    monkeypatch.setattr(worker, "RESTART_S", 0.0)
    process._process._process.kill()
    process._process._process.wait()
    starts, begun = process.starts, time.monotonic()
    while process.starts == starts and time.monotonic() - begun < PATIENCE_S:
        process.tend(time.monotonic())
        time.sleep(0.01)
    assert process.starts == starts + 1
    assert wait_for(process).run == TASK.run


def test_a_process_that_cannot_be_started_gives_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker.sys, "executable", "/nowhere/python")
    process = ExplorerProcess(RIG)
    process.prepare()
    process.prepare()
    process.ask(question(0.0))
    assert process.collect(0.0) is None
    process.close()


def test_closing_ends_the_process_at_once() -> None:
    process = ExplorerProcess(RIG)
    process.prepare()
    folder = Path(process._process._folder.name)
    process.close()
    assert process._process._process.poll() is not None
    assert not folder.exists()


@pytest.mark.parametrize("length", [83, 84])
def test_the_socket_works_with_a_long_path_of_temporary_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, length: int
) -> None:
    """A Unix socket's path has 107 bytes at most; `/palmd-`, eight letters and `/explorer` come after it."""
    with tempfile.TemporaryDirectory(dir="/tmp") as short:
        folder = Path(short) / "ü".ljust(length - len(short) - 2, "x")
        folder.mkdir(parents=True)
        monkeypatch.setattr(tempfile, "tempdir", str(folder))
        process = ExplorerProcess(RIG)
        process.prepare()
        own = Path(process._process._folder.name)
        assert own.is_relative_to(folder) == (length <= 83)
        assert own.stat().st_mode & 0o077 == 0
        wait_for(process)
        process.close()
        assert not own.exists()
        assert list(folder.iterdir()) == []


def test_another_system_uses_its_own_decider() -> None:
    process = ExplorerProcess(ThreePalmsRig(), DECIDER)
    process.prepare()
    try:
        here = (0.9, 0.8, 0.8)
        task = ExplorationTask(1, TiltGoal(), TiltLimits.over(ThreePalmsLimitsConfig(), 75.0))
        begun, answer = time.monotonic(), None
        while answer is None and time.monotonic() - begun < PATIENCE_S:
            process.ask(Question(1.0, task, None, UnderWay(Move(here, here, 0.0), 1.0)))
            time.sleep(0.02)
            answer = process.collect(1.0)
    finally:
        process.close()
    assert len(answer.decision.move.end) == 3
