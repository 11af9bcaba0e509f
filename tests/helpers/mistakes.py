"""Mistakes that people make, and what they are told: typed into the command line in a folder of their own."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

from palmd import cli

PORTS = "pads: {palm1: {port: /dev/a}, palm2: {port: /dev/b}}\narm: {port: /dev/c}\n"


class Mistake(NamedTuple):
    """What is typed, with which files there; the exit status and what is said."""

    typed: str
    status: int
    told: str
    files: dict[str, str] = {}  # noqa: RUF012


def check_answer(mistake: Mistake, folder: Path, monkeypatch, capsys) -> None:
    """Types it in `folder` and compares status, standard error and the files there afterwards."""
    typed, status, told, files = mistake
    monkeypatch.chdir(folder)
    monkeypatch.setattr("palmd.daemon.realtime.prepare", lambda *_: [])
    for path, text in files.items():
        Path(path).parent.mkdir(exist_ok=True)
        Path(path).write_text(text)
    try:
        ended = cli.main(typed.split())
    except SystemExit as caught:
        ended = caught.code
    captured = capsys.readouterr()
    said = re.sub(r"\Ausage: .*?^(?=palmd.*: error: )", "", captured.err, flags=re.DOTALL | re.MULTILINE)
    assert said == told.replace("{here}", str(folder)) + "\n"
    assert (ended, captured.out) == (status, "")
    assert {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()} == set(files)
