"""Packs a recorded run for a bug report: one zip with run, configuration, versions and doctor's findings.

Passwords, tokens, keys and names of home folders are removed from the texts. Check the bundle before you publish it:
the recording itself is packed unchanged.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import platform
import zipfile
from importlib.metadata import distributions
from pathlib import Path

from palmd import __version__
from palmd.console.configured import default_path
from palmd.console.errors import BAD_INPUT, CliError, writing
from palmd.console.redaction import redacted
from palmd.record import is_recording

RUN_BYTES_MOST = 1 << 31


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("run", type=Path, metavar="RUN", help="a recording (MCAP) or an event log")
    parser.add_argument("--config", type=Path, metavar="FILE", help="the configuration (default: from the recording)")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="default: RUN's name with .zip, here")


def run(arguments: argparse.Namespace) -> int:
    """Write the bundle and print its contents; CliError if the run cannot be read or the file not written."""
    path: Path = arguments.run
    output = arguments.output or Path(f"{path.stem}.zip")
    try:
        if path.stat().st_size > RUN_BYTES_MOST:
            raise CliError(BAD_INPUT, f"{path}: larger than {RUN_BYTES_MOST >> 30} GB: cut out the relevant part")
        recording = path.read_bytes()
        if not is_recording(path) and not recording.lstrip().startswith(b"{"):
            raise CliError(BAD_INPUT, f"{path}: is neither a recording (.mcap) nor an event log (.jsonl)")
    except (FileNotFoundError, IsADirectoryError) as error:
        what = "is a folder" if isinstance(error, IsADirectoryError) else "no such file"
        raise CliError(BAD_INPUT, f"{path}: {what}; `palmd runs FOLDER` lists the runs in one") from None
    except OSError as error:
        raise CliError(BAD_INPUT, f"{path}: {error.strerror}") from None
    texts = {"versions.txt": versions(), "doctor.txt": _findings(arguments.config)} | _of_run(path)
    if arguments.config is not None:
        texts["palmd.yaml"] = _read(arguments.config)
    with writing(output), zipfile.ZipFile(output, "w", zipfile.ZIP_DEFLATED) as bundle:
        bundle.writestr(path.name, recording)
        for name, text in texts.items():
            bundle.writestr(name, redacted(text))
    print(f"{output}: {', '.join([path.name, *texts])}; {output.stat().st_size / 1e6:.1f} MB")
    return 0


def versions() -> str:
    """Versions of palmd, Python, the platform and every installed package, one per line."""
    packages = sorted({f"{each.metadata['Name']} {each.version}" for each in distributions()}, key=str.lower)
    return "\n".join(
        [f"palmd {__version__}", f"Python {platform.python_version()}", platform.platform(), *packages, ""]
    )


def _of_run(path: Path) -> dict[str, str]:
    """Configuration and metadata of a recording, by file name; empty for an event log."""
    from palmd.record import RunError
    from palmd.record.metadata import CONFIG
    from palmd.record.run import read_any_run

    if not is_recording(path):
        return {}
    try:
        recorded = read_any_run(path)
    except RunError as error:
        return {"run-problem.txt": f"{error}\n"}
    texts = {"run.json": json.dumps(dict(recorded.metadata), indent=2) + "\n"}
    config = recorded.preface.attachments.get(CONFIG, b"").decode(errors="replace")
    return texts | ({CONFIG: config} if config else {})


def _findings(config: Path | None) -> str:
    """The output of `palmd doctor`."""
    from palmd.doctor.findings import examine_all

    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        try:
            examine_all(default_path(config))
        except CliError as error:
            print(error, file=output)
    return output.getvalue()


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise CliError(BAD_INPUT, f"{path}: {error.strerror}") from None
