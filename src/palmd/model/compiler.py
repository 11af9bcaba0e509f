"""The C compiler: which command it is, whether it works here, and runs of it that end.

It is tried on a small library before it is given long work. What is wrong with it is kept in the environment, so that
it is found out and said once: by the process that finds it, and by none of those that it starts.
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

TRIAL_S = 10.0  # for a library of one line
COMPILE_S = 900.0  # for one file, on a slow machine that does other things too
ROOM_BYTES = 64_000_000
"""What a folder must have left (study of 2026-11-29: all libraries take 22.3 MB, the largest meanwhile 14.7 MB more;
two at a time are 52 MB)."""

ANSWER = 42
FAULT = "PALMD_COMPILER_FAULT"
"""In the environment: the compiler and folder that do not go together."""

_TRIAL = f"int palmd_trial(void) {{ return {ANSWER}; }}\n"
_LINE_MOST = 300


class CompilerError(Exception):
    """The compiler does not work; its text is the reason in one line."""


def command() -> list[str]:
    """$CC as a shell splits it, else the first compiler that is installed, empty for none. Raises CompilerError."""
    try:
        words = shlex.split(os.environ.get("CC", ""))
    except ValueError as error:
        raise CompilerError(f"CC={os.environ['CC']}: {str(error).lower()}") from None
    found = next(filter(shutil.which, ("cc", "gcc", "clang")), None)
    return words or ([found] if found else [])


def installed() -> bool:
    """Whether there is anything to compile with; whether it works is found out by trying it."""
    try:
        words = command()
    except CompilerError:
        return False
    return bool(words) and shutil.which(words[0]) is not None


def known_fault(folder: Path) -> bool:
    """Whether this compiler has been found not to work for `folder`, by this process or by one that started it."""
    return os.environ.get(FAULT) == _key(folder)


def tried(compiler: Sequence[str], folder: Path) -> None:
    """Have the compiler make a small library in `folder`, which must have room for more, and call it.

    Raises CompilerError, OSError.
    """
    with tempfile.TemporaryDirectory(dir=folder) as name:
        _check_room(Path(name) / "room", folder)
        source, library = Path(name) / "trial.c", Path(name) / "trial.so"
        source.write_text(_TRIAL, encoding="utf-8")
        run([*compiler, "-shared", "-fPIC", "-o", str(library), str(source)], TRIAL_S)
        if not library.exists():
            raise CompilerError(f"{shlex.join(compiler)} ended well and made nothing")
        try:
            answer = ctypes.CDLL(str(library)).palmd_trial()
        except (OSError, AttributeError) as error:
            advice = "if its file system forbids programs (noexec), set XDG_CACHE_HOME to a folder where they may run"
            reason = str(error).removeprefix(f"{library}: ")
            raise CompilerError(f"a library in {folder} cannot be loaded: {reason}; {advice}") from None
        if answer != ANSWER:
            raise CompilerError(f"{shlex.join(compiler)} makes wrong code")


def _check_room(file: Path, folder: Path) -> None:
    """Raise CompilerError where the folder is full; found out here, not by each start's minutes of compiling."""
    with file.open("wb") as room:
        try:
            os.posix_fallocate(room.fileno(), 0, ROOM_BYTES)
        except OSError as error:
            advice = f"free {ROOM_BYTES / 1e6:g} MB there, or set XDG_CACHE_HOME to a folder that has them"
            raise CompilerError(f"{folder}: {error.strerror}; {advice}") from None
    file.unlink()


def remember_fault(folder: Path) -> None:
    """That the compiler does not work for `folder`."""
    os.environ[FAULT] = _key(folder)


def run(arguments: Sequence[str], limit_s: float) -> None:
    """Run it to its end; raises CompilerError with its own last line, or when it takes longer than `limit_s`."""
    try:
        process = subprocess.Popen(
            arguments, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, errors="replace", start_new_session=True,
        )  # fmt: skip
    except OSError as error:
        raise CompilerError(f"{arguments[0]}: {error.strerror or error}") from None
    with process:
        try:
            said, _ = process.communicate(timeout=limit_s)
        except subprocess.TimeoutExpired:
            raise CompilerError(f"{arguments[0]} has not ended within {limit_s:g} s") from None
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
    if process.returncode:
        lines = [line.strip() for line in said.splitlines() if line.strip()]
        blamed = [line for line in lines if "error" in line.lower()] or lines or ["it says nothing"]
        raise CompilerError(f"{arguments[0]} ended with status {process.returncode}: {blamed[-1][:_LINE_MOST]}")


def _key(folder: Path) -> str:
    return f"{os.environ.get('CC', '')} {folder}"
