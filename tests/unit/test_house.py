"""Rules for other systems and for searching: few files name a palm by number, and class names are unique."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

SOURCE = Path(__file__).parents[2] / "src" / "palmd"
"""m/s² and similar units within names."""
MOST_SHARED_NAMES = 0  # of classes


def sources() -> Iterator[tuple[Path, str]]:
    for path in sorted(SOURCE.rglob("*.py")):
        yield path.relative_to(SOURCE), path.read_text(encoding="utf-8")


def test_class_names_are_unique():
    homes = defaultdict(list)
    for path, text in sources():
        for name in re.findall(r"^ *class (\w+)", text, re.MULTILINE):
            homes[name].append(str(path))
    shared = {name: files for name, files in homes.items() if len(files) > 1}
    assert len(shared) <= MOST_SHARED_NAMES, shared


def test_no_two_test_files_share_a_name() -> None:
    """pytest imports a file by its name alone, and refuses the second."""
    names = Counter(path.name for path in Path(__file__).parents[1].rglob("test_*.py"))
    assert [name for name, times in names.items() if times > 1] == []
