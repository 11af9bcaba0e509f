"""Pages generated from the code's tables are up to date, and the README names only what exists."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def test_generated_pages_are_up_to_date() -> None:
    done = subprocess.run(
        [sys.executable, ROOT / "tools/make_docs.py", "--check"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("page", ["README.md", "docs/architecture.md", "docs/theory.md"])
def test_files_named_in_the_docs_exist(page: str) -> None:
    text = (ROOT / page).read_text()
    links = re.findall(r"\]\(([^)#]+)\)", text)
    files = re.findall(r"`((?:[a-z_]+/)+[a-z_0-9]+\.(?:py|md|yaml))`", text)
    for name in {*links, *files}:
        if name.startswith("http"):
            continue
        places = ((ROOT / page).parent / name, ROOT / name, ROOT / "src/palmd" / name)
        assert any(place.exists() for place in places), f"{page} names {name}, which is not there"
