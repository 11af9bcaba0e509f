"""Pages generated from the code's tables are up to date, and the README names only existing files."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tools.figures import FIGURES, GROUPS, MADE, made

ROOT = Path(__file__).parents[2]


def test_generated_pages_are_up_to_date() -> None:
    done = subprocess.run(
        [sys.executable, ROOT / "tools/make_docs.py", "--check"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


PAGES = ["README.md", *sorted(str(page.relative_to(ROOT)) for page in (ROOT / "docs").rglob("*.md"))]
FOLDERS = {
    "start",
    "operate",
    "reference",
    "theory",
    "results",
    "decisions",
    "figures",
    "commands.md",
    "configuration.md",
    "walkthrough.md",
}


def test_every_page_has_its_folder_and_is_linked_from_the_readme() -> None:
    assert {entry.name for entry in (ROOT / "docs").iterdir()} == FOLDERS
    reached, waiting = set(), {ROOT / "README.md"}
    while waiting:
        page = waiting.pop()
        reached.add(page)
        links = re.findall(r"\]\(([^)#]+\.md)", page.read_text())
        waiting |= {(page.parent / link).resolve() for link in links if not link.startswith("http")} - reached
    assert {page for page in PAGES if "/decisions/" not in page} <= {str(page.relative_to(ROOT)) for page in reached}


@pytest.mark.parametrize("page", PAGES)
def test_decisions_are_cited_by_their_number(page: str) -> None:
    text = (ROOT / page).read_text()
    for number, file in re.findall(r"\[(?:decisions? )?(\d+)\]\([^)]*decisions/(\d{4})-", text):
        assert int(number) == int(file), f"{page} calls the record {file} decision {number}"
    records = {int(record.name[:4]) for record in (ROOT / "docs/decisions").glob("*.md")}
    replaced = "Replaces decision" in text and "/decisions/" in page
    for numbers in re.findall(r"\b[Dd]ecisions? (\d+(?:(?:, | and )\d+)*)\b", text if not replaced else ""):
        assert {int(number) for number in re.findall(r"\d+", numbers)} <= records, f"{page}: decisions {numbers}"


@pytest.mark.parametrize("page", PAGES)
def test_files_named_in_the_docs_exist(page: str) -> None:
    text = (ROOT / page).read_text()
    links = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", text) + re.findall(r'src="([^"]+)"', text)
    files = re.findall(r"`((?:[a-z_]+/)+[a-z_0-9]+\.(?:py|md|yaml))`", text)
    for name in {*links, *files}:
        if name.startswith("http"):
            continue
        places = ((ROOT / page).parent / name, ROOT / name, ROOT / "src/palmd" / name)
        assert any(place.exists() for place in places), f"{page} names {name}, which does not exist"


def test_pages_named_in_the_code_exist() -> None:
    named = {}
    for file in (file for folder in ("src", "config", "tools") for file in (ROOT / folder).rglob("*")):
        if file.suffix in (".py", ".yaml", ".xml"):
            named |= dict.fromkeys(re.findall(r"docs/[\w/-]+\.(?:md|svg|py)", file.read_text()), file)
    assert len(named) > 5
    assert {name: file for name, file in named.items() if not (ROOT / name).exists()} == {}


def test_the_walk_goes_through_existing_places() -> None:
    text = (ROOT / "docs/walkthrough.md").read_text()
    places = re.findall(r"`([a-z_0-9/]+\.(?:py|js))(?::(\w+))?`", text)
    assert len(places) > 40
    for path, name in places:
        file = ROOT / "src/palmd" / path
        assert file.exists(), f"the walk goes through {path}, which does not exist"
        assert re.search(rf"\b{name}\b", file.read_text()), f"there is no {name} in {path}"


def test_the_papers_map_names_existing_functions() -> None:
    named = re.findall(r"`([a-z_0-9/]+)\.py:(\w+)`", (ROOT / "docs/theory/paper.md").read_text())
    assert len(named) > 20
    for path, name in named:
        package = "" if path.startswith(("tools/", "tests/")) else "palmd."
        module = importlib.import_module((package + path.replace("/", ".")).removeprefix("tests.helpers."))
        assert hasattr(module, name), f"docs/theory/paper.md names {path}.py:{name}, which does not exist"


def test_every_figure_has_a_record_of_how_it_was_made() -> None:
    rows = made()
    names = {path.name for path in FIGURES.iterdir()} - {MADE.name}
    assert names == set(rows)
    assert names == {file for group in GROUPS.values() for file in group.files}
    text = "".join((ROOT / page).read_text() for page in PAGES)
    assert [name for name in names if f"figures/{name}" not in text] == [], "on no page"
    for command, _, date, commit in rows.values():
        assert command
        assert re.fullmatch(r"\d{4}-\d\d-\d\d", date)
        assert re.fullmatch(r"[0-9a-f]{8,}", commit)
