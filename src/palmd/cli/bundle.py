"""Packs a recorded run for a bug report: one zip with run, configuration, versions and doctor's findings.

Secrets are removed: passwords, tokens and keys in the texts, and the names of home folders. Look through it all the
same before it is published: the recording itself is packed as it is.
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
from palmd.console.configured import usual
from palmd.console.errors import BAD_INPUT, CliError
from palmd.console.redaction import redacted
from palmd.record import is_recording

RUN_BYTES_MOST = 1 << 31


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("run", type=Path, metavar="RUN", help="a recording (MCAP) or an event log")
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="the configuration (default: that of the recording)"
    )
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="default: RUN's name with .zip, here")


def run(arguments: argparse.Namespace) -> int:
    """Prints what is in it; CliError for a run that cannot be read and a file that cannot be written."""
    path: Path = arguments.run
    output = arguments.output or Path(f"{path.stem}.zip")
    try:
        if path.stat().st_size > RUN_BYTES_MOST:
            raise CliError(BAD_INPUT, f"{path}: larger than {RUN_BYTES_MOST >> 30} GB: cut out the part that matters")
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
    try:
        with zipfile.ZipFile(output, "w", zipfile.ZIP_DEFLATED) as bundle:
            bundle.writestr(path.name, recording)
            for name, text in texts.items():
                bundle.writestr(name, redacted(text))
    except OSError as error:
        raise CliError(BAD_INPUT, f"{output}: cannot be written: {error.strerror}") from None
    print(f"{output}: {', '.join([path.name, *texts])}; {output.stat().st_size / 1e6:.1f} MB")
    return 0


def versions() -> str:
    """palmd, Python, the machine and every package that is installed, a line each."""
    packages = sorted({f"{each.metadata['Name']} {each.version}" for each in distributions()}, key=str.lower)
    return "\n".join(
        [f"palmd {__version__}", f"Python {platform.python_version()}", platform.platform(), *packages, ""]
    )


def _of_run(path: Path) -> dict[str, str]:
    """What the recording says of its configuration and its versions; nothing for an event log."""
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
    """What `palmd doctor` says, its standard output as it stands."""
    from palmd.doctor.findings import examine_all

    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        try:
            examine_all(usual(config))
        except CliError as error:
            print(error, file=said)
    return said.getvalue()


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise CliError(BAD_INPUT, f"{path}: {error.strerror}") from None
