"""All tests and linters, side by side: those on the emulated rig one by one in real time, and in what they leave of the
machine all others.

A rig's test sleeps most of the time, but what it starts must be awake when it is due; so the others stand back, and no
two rigs run at once. Services that boot do little but wait, and go beside. One that fails all the same is tried again
while others still run, which takes nobody's time, and if need be once more when everything else is over and the machine
is quiet: that is what counts.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from typing import IO, NamedTuple

NICE = 10
TESTS_FAILED = 1  # pytest's status, when it ran to the end
BESIDE = {"PALMD_TESTS_BESIDE": "1"}  # tells a rig's tests that no quiet moment is to be waited for
PYTEST = (sys.executable, "-m", "pytest", "-q", "--durations=15")
WAITING = ("tests/rig", "tests/system")
WORKERS = (os.cpu_count() or 1) + 1  # one more than there are processors, for tests that wait
OTHERS = (*WAITING, "tests/bench", "tests/vm")


class Part(NamedTuple):
    """What runs beside the others, some by many `workers`.

    The tests of a `rig` go before them, and are tried again; one `talks` as it runs.
    """

    name: str
    command: tuple[str, ...]
    rig: bool = False
    talks: bool = False
    workers: int = 0


def parts() -> list[Part]:
    """In the order in which they are told of."""
    ignored = tuple(f"--ignore={path}" for path in OTHERS)
    return [
        # what is installed stays as it is: an installation that is renewed is none for a moment, for those beside too
        Part("linters", ("make", "--no-print-directory", "--old-file=dev", "lint")),
        Part("rig", (*PYTEST, *cached("rig"), "tests/rig"), rig=True, talks=True),
        Part("system", (*PYTEST, *cached("system"), "tests/system"), rig=True),
        Part("all others", (*PYTEST, *ignored), workers=WORKERS),
    ]


def cached(name: str) -> tuple[str, str]:
    """Each part remembers by itself what has failed."""
    return "-o", f"cache_dir=.pytest_cache/{name}"


def collected(part: Part) -> None:
    """Have pytest rewrite what the tests assert, and keep it: each worker would rewrite all of it at the same time."""
    command = [*part.command, "--collect-only"]
    subprocess.run(command, check=False, stdout=subprocess.DEVNULL, preexec_fn=lambda: os.nice(NICE))


def begin(part: Part, told: IO[str], arguments: list[str]) -> subprocess.Popen[str]:
    """The part as a process; `arguments` go to tests only."""
    extra = arguments if part.command[0] == sys.executable else []
    if part.workers:
        collected(part)
        extra = ["-n", str(part.workers), "--dist", "worksteal", *extra]
    return subprocess.Popen(
        [*part.command, *extra],
        stdout=None if part.talks else told, stderr=None if part.talks else subprocess.STDOUT, text=True,
        env=os.environ | (BESIDE if part.rig else {}),
        preexec_fn=None if part.rig else lambda: os.nice(NICE),
    )  # fmt: skip


def tried_again(part: Part, arguments: list[str], *, beside: bool) -> int:
    """The status of those that have failed, beside what still runs or now that nothing does."""
    print(f"\n{part.name}: what has failed is tried again, {'beside others' if beside else 'by itself'}", flush=True)
    command = [*part.command, "--last-failed", *arguments]
    return subprocess.run(command, env=os.environ | (BESIDE if beside else {}), check=False).returncode


def main(arguments: list[str]) -> int:
    """0 when all have passed; `arguments` go to all tests."""
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # some hundred processes import the same
    begun = time.monotonic()
    running: list[tuple[Part, subprocess.Popen[str], IO[str]]] = []
    statuses: dict[Part, int] = {}
    try:
        for part in parts():
            told = tempfile.TemporaryFile("w+")  # noqa: SIM115
            running.append((part, begin(part, told, arguments), told))
        for part, process, told in running:
            statuses[part] = process.wait()
            told.seek(0)
            print(f"\n---- {part.name}, over by {time.monotonic() - begun:.0f} s\n{told.read()}", end="", flush=True)
            others_run = any(each.poll() is None for _, each, _ in running)
            if part.rig and statuses[part] == TESTS_FAILED and others_run:
                statuses[part] = tried_again(part, arguments, beside=True)
    finally:
        for _, process, told in running:
            process.terminate()
            told.close()
    for part, status in statuses.items():
        if part.rig and status == TESTS_FAILED:
            statuses[part] = tried_again(part, arguments, beside=False)
    failed = [part.name for part, status in statuses.items() if status]
    print(f"\n{time.monotonic() - begun:.0f} s, failed: {', '.join(failed) or 'nothing'}")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
