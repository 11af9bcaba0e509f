"""Recorded runs and configuration for pages that may operate: list, report, download, delete, check.

Slow work is done by another palmd command in its own process with lower priority, so that the page's frames continue.
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
from palmd.view.http_guard import File
from palmd.yamlfile import ConfigError, load_any_config

COMMANDS = ("runs", "report", "delete", "configuration")
FILES = "/files/"
SUFFIX = ".mcap"
MAX_FILE_BYTES = 1 << 28
"""Largest file that is sent to a page."""

BEING_WRITTEN_S = 3.0
"""A file modified less than this long ago is being recorded."""

NICE = 10


class LibraryError(Exception):
    """The request cannot be fulfilled; the text is one line with the reason."""


class RunLibrary:
    """Access to the runs and the configuration; pages need `key` to download files."""

    def __init__(self, runs: Path | None, config: Path | None) -> None:
        """`runs`: folder of the runs, None for the one in the configuration."""
        self.key = secrets.token_urlsafe(16)
        self._runs, self._config = runs, config
        self._reports = tempfile.TemporaryDirectory(prefix="palmd-reports-")
        self._lock = asyncio.Lock()

    def close(self) -> None:
        """Remove the generated reports."""
        self._reports.cleanup()

    async def execute(self, command: str, args: Mapping[str, Any]) -> dict[str, Any]:
        """Execute one of `COMMANDS`; raises LibraryError."""
        async with self._lock:
            match command:
                case "runs":
                    return await self._list_runs()
                case "report":
                    return await self._report(self._run(args))
                case "delete":
                    return await asyncio.to_thread(self._delete, self._run(args))
                case _:
                    return await self._check_configuration()

    def find(self, path: str) -> Callable[[], File] | None:
        """A function that reads the file at a URL path under `FILES`; None if it does not exist or the key is wrong."""
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
        if run.stat().st_size > MAX_FILE_BYTES:
            return None
        return lambda: File(run.read_bytes(), "application/octet-stream")

    # -- commands -----------------------------------------------------------------------------------------

    async def _list_runs(self) -> dict[str, Any]:
        folder = self._folder()
        if not folder.is_dir():
            return {"folder": str(folder), "runs": []}
        output = await self._palmd("runs", str(folder), "--json")
        return {"folder": str(folder), "runs": json.loads(output)}

    async def _report(self, run: Path) -> dict[str, Any]:
        output = Path(self._reports.name) / f"{run.stem}.html"
        if not output.exists():
            await self._palmd("report", str(run), "-o", str(output))
        return {"file": output.name}

    def _delete(self, run: Path) -> dict[str, Any]:
        if time.time() - run.stat().st_mtime < BEING_WRITTEN_S:
            raise LibraryError(f"{run.name} is being recorded: delete it after the run has ended")
        try:
            run.unlink()
            run.with_suffix(".note").unlink(missing_ok=True)
        except OSError as error:
            raise LibraryError(f"{run.name} cannot be deleted: {error.strerror}") from None
        (Path(self._reports.name) / f"{run.stem}.html").unlink(missing_ok=True)
        return {}

    async def _check_configuration(self) -> dict[str, Any]:
        if self._config is None:
            raise LibraryError("no configuration is known: start palmd view with --config FILE")
        try:
            text = self._config.read_text(encoding="utf-8", errors="replace")
        except OSError as error:
            raise LibraryError(f"{self._config} cannot be read: {error.strerror}") from None
        result = json.loads(await self._palmd("check", "--json", str(self._config), accept=(0, 1)))
        return {"path": str(self._config), "text": redacted(text), "findings": result["problems"]}

    # -- paths ----------------------------------------------------------------------------------------------

    def _folder(self) -> Path:
        if self._runs is not None:
            return self._runs
        if self._config is None:
            raise LibraryError("no folder of runs is known: start palmd view with --runs FOLDER")
        try:
            return load_any_config(self._config).record.directory
        except ConfigError as error:
            raise LibraryError(error.errors[0]) from None

    def _run(self, args: Mapping[str, Any]) -> Path:
        return self._named(str(args.get("run", "")))

    def _named(self, name: str) -> Path:
        """The run with that file name; only names in the folder are accepted, so no path leads outside."""
        folder = self._folder()
        try:
            with os.scandir(folder) as entries:
                if name.endswith(SUFFIX) and any(each.name == name and each.is_file() for each in entries):
                    return folder / name
        except OSError as error:
            raise LibraryError(f"{folder}: {error.strerror}") from None
        raise LibraryError(f"there is no run {name!r} in {folder}")

    async def _palmd(self, *arguments: str, accept: tuple[int, ...] = (0,)) -> str:
        """Standard output of a palmd command; raises LibraryError with the last line of its errors if it fails."""
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
