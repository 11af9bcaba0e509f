"""Pages generated from the code's tables are up to date, and the README names only what exists."""

from __future__ import annotations

import importlib
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


PAGES = [
    "README.md",
    *(
        f"docs/{name}.md"
        for name in (
            *("architecture", "theory", "paper", "limits", "calibration", "exploring", "subscribing"),
            *(
                "start/library",
                "recordings",
                "page",
                "reports",
                "operations",
                "bringup",
                "security",
                "campaign",
                "soak",
                "fuzzing",
            ),
        )
    ),
]


@pytest.mark.parametrize("page", PAGES)
def test_files_named_in_the_docs_exist(page: str) -> None:
    text = (ROOT / page).read_text()
    links = re.findall(r"\]\(([^)#]+)\)", text)
    files = re.findall(r"`((?:[a-z_]+/)+[a-z_0-9]+\.(?:py|md|yaml))`", text)
    for name in {*links, *files}:
        if name.startswith("http"):
            continue
        places = ((ROOT / page).parent / name, ROOT / name, ROOT / "src/palmd" / name)
        assert any(place.exists() for place in places), f"{page} names {name}, which is not there"


def test_the_papers_map_names_what_is_there() -> None:
    named = re.findall(r"`([a-z_0-9/]+)\.py:(\w+)`", (ROOT / "docs/paper.md").read_text())
    assert len(named) > 20
    for path, name in named:
        module = importlib.import_module("palmd." + path.replace("/", "."))
        assert hasattr(module, name), f"docs/paper.md names {path}.py:{name}, which is not there"
