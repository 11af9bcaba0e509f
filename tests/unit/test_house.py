"""What keeps palmd open for other systems and easy to search: few files name a palm by number, no two classes alike."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

SOURCE = Path(__file__).parents[2] / "src" / "palmd"
"""m/s² and its like within names."""
MOST_SHARED_NAMES = 0  # of classes


def sources() -> Iterator[tuple[Path, str]]:
    for path in sorted(SOURCE.rglob("*.py")):
        yield path.relative_to(SOURCE), path.read_text(encoding="utf-8")


def test_hardly_a_class_name_means_two_things():
    homes = defaultdict(list)
    for path, text in sources():
        for name in re.findall(r"^ *class (\w+)", text, re.MULTILINE):
            homes[name].append(str(path))
    shared = {name: files for name, files in homes.items() if len(files) > 1}
    assert len(shared) <= MOST_SHARED_NAMES, shared


def test_no_two_files_of_tests_share_a_name() -> None:
    """pytest imports a file by its name alone, and refuses the second."""
    names = Counter(path.name for path in Path(__file__).parents[1].rglob("test_*.py"))
    assert [name for name, times in names.items() if times > 1] == []
