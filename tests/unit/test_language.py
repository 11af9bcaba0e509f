"""palmd speaks standard technical English: words of its former private language may not come back.

The standard terms are in docs/reference/glossary.md. Former names of published fields are in one table,
`palmd.aliases`, and stay until 2.0; what is left beside them are titles of the paper and terms of operating systems.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
NOT_OURS = {"corpus", "axe-core"}  # stored outputs, a library
MOST = 22
"""How many may be left in source and documentation; may only be lowered."""
MOST_IN_TESTS = 19
"""The same in tests and tools, apart from this file."""

PRIVATE = frozenset(
    re.findall(
        "[a-z]+",
        """
        told tell tells telling untold claim claims claimed claiming vouch vouched vouches foretell foretold foretells
        foreseen foresee foresees foresight startled surprise surprised surprises surprising astray anew folded raced
        eased roughened slack strain dear seeker follower felt feel feels ride rides ridden riding seat seats footing
        likeness lopsided wish wishes mischief outlook
        """,
    )
)
WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")
"""Parts of identifiers count, too: `told_sd`, `FeltOutline`."""
FORMER_NAMES = {"aliases.py", "former-names.md"}
"""The table of former names and the page generated from it."""
SUFFIXES = {".py", ".c", ".h", ".js", ".html", ".css", ".md"}


def sources() -> list[Path]:
    found = [*files("src", "docs"), ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"]
    return [path for path in found if "vendor" not in path.parts and path.name not in FORMER_NAMES]


def checks_and_tools() -> list[Path]:
    return [path for path in files("tests", "tools") if path != Path(__file__) and not NOT_OURS & {*path.parts}]


def files(*folders: str) -> list[Path]:
    return [path for folder in folders for path in (ROOT / folder).rglob("*") if path.suffix in SUFFIXES]


def private_words(text: str) -> list[str]:
    return [word for word in map(str.lower, WORD.findall(text)) if word in PRIVATE]


def test_parts_of_names_are_counted_and_parts_of_words_are_not() -> None:
    assert private_words("told_sd = FeltOutline(TOLD)  # constrained by the foothold") == ["told", "felt", "told"]


@pytest.mark.parametrize(("find", "most"), [(sources, MOST), (checks_and_tools, MOST_IN_TESTS)])
def test_few_private_words_are_left(find: Callable[[], list[Path]], most: int) -> None:
    found = Counter[str]()
    for path in find():
        words = private_words(path.read_text(encoding="utf-8"))
        found += Counter(f"{path.relative_to(ROOT)}: {word}" for word in words)
    assert found.total() <= most, f"{found.total()} private words, see docs/reference/glossary.md: {dict(found)}"
