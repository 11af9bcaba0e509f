"""Every palmd command in a block of the documentation can be parsed."""

from __future__ import annotations

import ast
import io
import re
import shlex
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import pytest

from palmd.cli import _requested

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)
ANY_RUN = {
    "RUN": "run.mcap",
    "LOG": "run.jsonl",
    "FILE": "file",
    "CONFIG": "my.yaml",
    "FOLDER": "folder",
    "PLAN": "p.yaml",
}


def blocks(kind: str) -> Iterator[tuple[Path, str]]:
    for page in PAGES:
        if "decisions" not in page.parts:
            yield from ((page, text) for found, text in BLOCK.findall(page.read_text()) if found == kind)


def commands() -> Iterator[tuple[str, str]]:
    """Page and words of each command, without comments, pipes and anything before it on the line."""
    for page, text in (*blocks(""), *blocks("sh"), *blocks("bash"), *blocks("console")):
        for line in text.replace("\\\n", " ").splitlines():
            found = re.match(r"(?:\$ )?(?:[A-Z_]+=\S+ )*(?:sudo |\./|\.venv/bin/|/opt/palmd/bin/)*palmd (.*)", line)
            if found and "…" not in line and "[" not in line:
                words = re.split(r"\s#|\s[|>&]|;", found[1])[0]
                yield page.relative_to(ROOT).as_posix(), words.strip()


@pytest.mark.parametrize(("page", "words"), sorted(set(commands())))
def test_a_command_in_the_documentation_parses(page: str, words: str) -> None:
    typed = [ANY_RUN.get(each, each) for each in shlex.split(words)]
    said = io.StringIO()
    code = None
    try:
        with redirect_stderr(said), redirect_stdout(io.StringIO()):
            _requested(typed)
    except SystemExit as ended:
        code = ended.code
    assert code in (0, None), f"{page}: palmd {words}: {said.getvalue()}"
    assert " is now: " not in said.getvalue(), f"{page}: palmd {words} is a former spelling"


def test_many_commands_are_documented() -> None:
    assert len(set(commands())) > 40


@pytest.mark.parametrize(("page", "text"), list(blocks("python")), ids=str)
def test_a_documented_program_exists(page: Path, text: str) -> None:
    ast.parse(text, filename=str(page))
