"""Run all tests and linters in parallel: rig tests one by one in real time, all others with lower priority.

A rig's test sleeps most of the time, but its processes must run on time when they are due; therefore the others have
lower priority, and no two rigs run at once. Tests of booting services mostly wait and run in parallel. A rig test that
fails is repeated while others still run, and once more after everything else has ended; that last result counts.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from typing import IO, NamedTuple

NICE = 10
TESTS_FAILED = 1  # pytest's status if it ran to the end with failures
BESIDE = {"PALMD_TESTS_BESIDE": "1"}  # rig tests do not wait for a quiet machine
PYTEST = (sys.executable, "-m", "pytest", "-q", "--durations=15")
WAITING = ("tests/rig", "tests/system")
WORKERS = (os.cpu_count() or 1) + 1  # one more than processors, for tests that wait
OTHERS = (*WAITING, "tests/bench", "tests/vm")


class Part(NamedTuple):
    """A part of the tests, run in parallel with the others.

    rig: runs with normal priority and is repeated on failure. talks: its output is shown immediately. workers: number
    of parallel processes of pytest.
    """

    name: str
    command: tuple[str, ...]
    rig: bool = False
    talks: bool = False
    workers: int = 0


def parts() -> list[Part]:
    """All parts, in the order of their reports."""
    ignored = tuple(f"--ignore={path}" for path in OTHERS)
    return [
        # no reinstallation, which would make the package unavailable for a moment to the other parts
        Part("linters", ("make", "--no-print-directory", "--old-file=dev", "lint")),
        Part("rig", (*PYTEST, *cached("rig"), "tests/rig"), rig=True, talks=True),
        Part("system", (*PYTEST, *cached("system"), "tests/system"), rig=True),
        Part("all others", (*PYTEST, *ignored), workers=WORKERS),
    ]


def cached(name: str) -> tuple[str, str]:
    """Options for a cache of failed tests of each part's own."""
    return "-o", f"cache_dir=.pytest_cache/{name}"


def collected(part: Part) -> None:
    """Let pytest cache its rewritten assertions; else each worker would rewrite all of them at the same time."""
    command = [*part.command, "--collect-only"]
    subprocess.run(command, check=False, stdout=subprocess.DEVNULL, preexec_fn=lambda: os.nice(NICE))


def begin(part: Part, output: IO[str], arguments: list[str]) -> subprocess.Popen[str]:
    """Start a part as a process; `arguments` are passed to tests only."""
    extra = arguments if part.command[0] == sys.executable else []
    if part.workers:
        collected(part)
        extra = ["-n", str(part.workers), "--dist", "worksteal", *extra]
    return subprocess.Popen(
        [*part.command, *extra],
        stdout=None if part.talks else output, stderr=None if part.talks else subprocess.STDOUT, text=True,
        env=os.environ | (BESIDE if part.rig else {}),
        preexec_fn=None if part.rig else lambda: os.nice(NICE),
    )  # fmt: skip


def tried_again(part: Part, arguments: list[str], *, beside: bool) -> int:
    """Repeat the failed tests, `beside` other parts or alone; returns the status."""
    print(f"\n{part.name}: repeating failed tests, {'beside others' if beside else 'alone'}", flush=True)
    command = [*part.command, "--last-failed", *arguments]
    return subprocess.run(command, env=os.environ | (BESIDE if beside else {}), check=False).returncode


def main(arguments: list[str]) -> int:
    """Run all parts; returns 0 if all have passed. `arguments` are passed to all tests."""
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # some hundred processes import the same modules
    t_start = time.monotonic()
    running: list[tuple[Part, subprocess.Popen[str], IO[str]]] = []
    statuses: dict[Part, int] = {}
    try:
        for part in parts():
            output = tempfile.TemporaryFile("w+")  # noqa: SIM115
            running.append((part, begin(part, output, arguments), output))
        for part, process, output in running:
            statuses[part] = process.wait()
            output.seek(0)
            print(f"\n---- {part.name}, after {time.monotonic() - t_start:.0f} s\n{output.read()}", end="", flush=True)
            others_run = any(each.poll() is None for _, each, _ in running)
            if part.rig and statuses[part] == TESTS_FAILED and others_run:
                statuses[part] = tried_again(part, arguments, beside=True)
    finally:
        for _, process, output in running:
            process.terminate()
            output.close()
    for part, status in statuses.items():
        if part.rig and status == TESTS_FAILED:
            statuses[part] = tried_again(part, arguments, beside=False)
    failed = [part.name for part, status in statuses.items() if status]
    print(f"\n{time.monotonic() - t_start:.0f} s, failed: {', '.join(failed) or 'nothing'}")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
