"""The C compiler: find the command, check that it works, run it with a time limit.

It is checked with a tiny library before long compilations. A fault is remembered in the environment, so that it is
reported once, by the process that found it and not by its child processes.
"""

from __future__ import annotations

import ctypes
import os
import shlex
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

TRIAL_S = 10.0  # time limit for the trial library of one line
COMPILE_S = 900.0  # time limit for one file, on a slow and busy machine
ROOM_BYTES = 64_000_000
"""Free space that a folder must have (study of 2026-11-29: all libraries take 22.3 MB, the largest needs 14.7 MB more
while it is built; two at a time need 52 MB)."""

ANSWER = 42
FAULT = "PALMD_COMPILER_FAULT"
"""Environment variable: the compiler and folder for which compiling was found not to work."""

_TRIAL = f"int palmd_trial(void) {{ return {ANSWER}; }}\n"
_LINE_MOST = 300


class CompilerError(Exception):
    """The compiler does not work; the message gives the reason in one line."""


def command() -> list[str]:
    """Return $CC split as by a shell, else the first installed compiler, else []; CompilerError for a malformed $CC."""
    try:
        words = shlex.split(os.environ.get("CC", ""))
    except ValueError as error:
        raise CompilerError(f"CC={os.environ['CC']}: {str(error).lower()}") from None
    found = next(filter(shutil.which, ("cc", "gcc", "clang")), None)
    return words or ([found] if found else [])


def installed() -> bool:
    """True if a compiler is installed; `check_compiler` finds out whether it works."""
    try:
        words = command()
    except CompilerError:
        return False
    return bool(words) and shutil.which(words[0]) is not None


def known_fault(folder: Path) -> bool:
    """True if this process or a parent has found that the compiler does not work for `folder`."""
    return os.environ.get(FAULT) == _key(folder)


def check_compiler(compiler: Sequence[str], folder: Path) -> None:
    """Compile a tiny library in `folder`, load and call it; check that the folder has `ROOM_BYTES` free.

    Raises CompilerError, OSError.
    """
    with tempfile.TemporaryDirectory(dir=folder) as name:
        _check_room(Path(name) / "room", folder)
        source, library = Path(name) / "trial.c", Path(name) / "trial.so"
        source.write_text(_TRIAL, encoding="utf-8")
        run([*compiler, "-shared", "-fPIC", "-o", str(library), str(source)], TRIAL_S)
        if not library.exists():
            raise CompilerError(f"{shlex.join(compiler)} reported success but wrote no library")
        try:
            answer = ctypes.CDLL(str(library)).palmd_trial()
        except (OSError, AttributeError) as error:
            advice = "if its file system is mounted noexec, set XDG_CACHE_HOME to a folder that allows programs"
            reason = str(error).removeprefix(f"{library}: ")
            raise CompilerError(f"a library in {folder} cannot be loaded: {reason}; {advice}") from None
        if answer != ANSWER:
            raise CompilerError(f"{shlex.join(compiler)} produces wrong code: the trial library returned a wrong value")


def _check_room(file: Path, folder: Path) -> None:
    """Raise CompilerError if the folder is full, before each start spends minutes compiling in vain."""
    with file.open("wb") as room:
        try:
            os.posix_fallocate(room.fileno(), 0, ROOM_BYTES)
        except OSError as error:
            advice = f"free {ROOM_BYTES / 1e6:g} MB there, or set XDG_CACHE_HOME to a folder with more space"
            raise CompilerError(f"{folder}: {error.strerror}; {advice}") from None
    file.unlink()


def remember_fault(folder: Path) -> None:
    """Record in the environment that the compiler does not work for `folder`."""
    os.environ[FAULT] = _key(folder)


def run(arguments: Sequence[str], limit_s: float) -> None:
    """Run a command; raises CompilerError with its last error line if it fails or takes longer than `limit_s`."""
    try:
        process = subprocess.Popen(
            arguments, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, errors="replace", start_new_session=True,
        )  # fmt: skip
    except OSError as error:
        raise CompilerError(f"{arguments[0]}: {error.strerror or error}") from None
    with process:
        try:
            output, _ = process.communicate(timeout=limit_s)
        except subprocess.TimeoutExpired:
            raise CompilerError(f"{arguments[0]} has not ended within {limit_s:g} s") from None
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
    if process.returncode:
        lines = [line.strip() for line in output.splitlines() if line.strip()]
        reasons = [line for line in lines if "error" in line.lower()] or lines or ["no output"]
        raise CompilerError(f"{arguments[0]} ended with status {process.returncode}: {reasons[-1][:_LINE_MOST]}")


def _key(folder: Path) -> str:
    return f"{os.environ.get('CC', '')} {folder}"
