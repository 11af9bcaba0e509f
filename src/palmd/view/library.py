"""The recorded runs and the configuration, for pages that may operate: listed, reported, fetched, deleted, checked.

What takes its time is another palmd command in a process of its own and of lower priority, so that the page's frames
go on.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import os
import secrets
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from palmd.console.redaction import redacted
from palmd.view.files import File
from palmd.yamlfile import ConfigError, load_any_config

COMMANDS = ("runs", "report", "delete", "configuration")
FILES = "/files/"
SUFFIX = ".mcap"
FILE_BYTES_MOST = 1 << 28
"""Of a file that is sent as a whole."""

BEING_WRITTEN_S = 3.0
"""A file that was written to so lately is being recorded."""

NICE = 10


class LibraryError(Exception):
    """What was asked for cannot be done; the text is one line that says why."""


class RunLibrary:
    """Knows where the runs and the configuration are; `key` opens its files."""

    def __init__(self, runs: Path | None, config: Path | None) -> None:
        """`runs`: None for the folder that the configuration names."""
        self.key = secrets.token_urlsafe(16)
        self._runs, self._config = runs, config
        self._reports = tempfile.TemporaryDirectory(prefix="palmd-reports-")
        self._one_at_a_time = asyncio.Lock()

    def close(self) -> None:
        """Removes the reports that were made."""
        self._reports.cleanup()

    async def obey(self, command: str, args: Mapping[str, Any]) -> dict[str, Any]:
        """The result of one of `COMMANDS`; raises LibraryError."""
        async with self._one_at_a_time:
            match command:
                case "runs":
                    return await self._listed()
                case "report":
                    return await self._report(self._run(args))
                case "delete":
                    return await asyncio.to_thread(self._delete, self._run(args))
                case _:
                    return await self._checked()

    def find(self, path: str) -> Callable[[], File] | None:
        """Reads the file at a path under `FILES`; None where there is none, or without the key."""
        key, _, name = path.removeprefix(FILES).partition("/")
        if not path.startswith(FILES) or not hmac.compare_digest(key.encode(), self.key.encode()):
            return None
        report = Path(self._reports.name) / name
        if "/" not in name and report.suffix == ".html" and report.is_file():
            return lambda: File(report.read_bytes(), "text/html; charset=utf-8")
        try:
            run = self._named(name)
        except LibraryError:
            return None
        if run.stat().st_size > FILE_BYTES_MOST:
            return None
        return lambda: File(run.read_bytes(), "application/octet-stream")

    # -- what it does -------------------------------------------------------------------------------------

    async def _listed(self) -> dict[str, Any]:
        folder = self._folder()
        if not folder.is_dir():
            return {"folder": str(folder), "runs": []}
        said = await self._palmd("runs", str(folder), "--json")
        return {"folder": str(folder), "runs": json.loads(said)}

    async def _report(self, run: Path) -> dict[str, Any]:
        output = Path(self._reports.name) / f"{run.stem}.html"
        if not output.exists():
            await self._palmd("report", str(run), "-o", str(output))
        return {"file": output.name}

    def _delete(self, run: Path) -> dict[str, Any]:
        if time.time() - run.stat().st_mtime < BEING_WRITTEN_S:
            raise LibraryError(f"{run.name} is being recorded: delete it when the run is over")
        try:
            run.unlink()
            run.with_suffix(".note").unlink(missing_ok=True)
        except OSError as error:
            raise LibraryError(f"{run.name} cannot be deleted: {error.strerror}") from None
        (Path(self._reports.name) / f"{run.stem}.html").unlink(missing_ok=True)
        return {}

    async def _checked(self) -> dict[str, Any]:
        if self._config is None:
            raise LibraryError("no configuration is known here: start palmd view --config FILE")
        try:
            text = self._config.read_text(encoding="utf-8", errors="replace")
        except OSError as error:
            raise LibraryError(f"{self._config} cannot be read: {error.strerror}") from None
        said = json.loads(await self._palmd("check", "--json", str(self._config), accept=(0, 1)))
        return {"path": str(self._config), "text": redacted(text), "findings": said["problems"]}

    # -- where things are -----------------------------------------------------------------------------------

    def _folder(self) -> Path:
        if self._runs is not None:
            return self._runs
        if self._config is None:
            raise LibraryError("no folder of runs is known here: start palmd view --runs FOLDER")
        try:
            return load_any_config(self._config).record.directory
        except ConfigError as error:
            raise LibraryError(error.errors[0]) from None

    def _run(self, args: Mapping[str, Any]) -> Path:
        return self._named(str(args.get("run", "")))

    def _named(self, name: str) -> Path:
        """The run of that file name; nothing else can be named, so that no path leads anywhere else."""
        folder = self._folder()
        try:
            with os.scandir(folder) as entries:
                if name.endswith(SUFFIX) and any(each.name == name and each.is_file() for each in entries):
                    return folder / name
        except OSError as error:
            raise LibraryError(f"{folder}: {error.strerror}") from None
        raise LibraryError(f"there is no run {name!r} in {folder}")

    async def _palmd(self, *arguments: str, accept: tuple[int, ...] = (0,)) -> str:
        """Standard output of a palmd command; LibraryError with its own last line when it fails."""
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-P", "-m", "palmd", *arguments,
            stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
            preexec_fn=lambda: os.nice(NICE) and None,
        )  # fmt: skip
        try:
            out, err = await process.communicate()
        except asyncio.CancelledError:
            process.kill()
            raise
        if process.returncode not in accept:
            lines = err.decode(errors="replace").strip().splitlines() or [f"status {process.returncode}"]
            raise LibraryError(f"palmd {arguments[0]}: {lines[-1]}")
        return out.decode()
