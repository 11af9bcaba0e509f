"""What keeps palmd open for other systems and easy to search: few files name a palm by number, no two classes alike."""

from __future__ import annotations

import ast
import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

SOURCE = Path(__file__).parents[2] / "src" / "palmd"
MOST_NAMING_A_PALM = 35
OF_A_PALM = (
    *("palm", "pad", "gap", "length", "curvature", "force"),
    *("phi", "omega", "alpha", "theta", "mu", "r", "s", "d", "v", "l", "R"),
)
NAMES_A_PALM = re.compile(rf"(?<![A-Za-z0-9-])(?:{'|'.join(OF_A_PALM)})[ _]?[12](?![0-9A-Za-z.])")
UNIT = re.compile(r"(?:(?:m|rad|deg) s2|(?<=/)s2)\b")
"""m/s² and its like within names."""
MOST_SHARED_NAMES = 0  # of classes


def sources() -> Iterator[tuple[Path, str]]:
    for path in sorted(SOURCE.rglob("*.py")):
        yield path.relative_to(SOURCE), path.read_text(encoding="utf-8")


def docstrings(tree: ast.Module) -> set[ast.Constant]:
    bodies = [node.body for node in ast.walk(tree) if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef))]
    firsts = [body[0].value for body in bodies if body and isinstance(body[0], ast.Expr)]
    return {first for first in firsts if isinstance(first, ast.Constant)}


def said(tree: ast.Module) -> Iterator[str]:
    """Every name, and every text that is no docstring."""
    prose = docstrings(tree)
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in prose:
            yield node.value
        for field in ("id", "attr", "arg", "name"):
            name = getattr(node, field, None)
            if isinstance(name, str):
                yield name


def counts_palms(tree: ast.Module) -> bool:
    """Whether something goes through a literal (1, 2)."""
    through: list[ast.expr] = []
    for node in ast.walk(tree):
        if isinstance(node, (ast.For, ast.comprehension)):
            through.append(node.iter)
        elif isinstance(node, ast.Compare):
            through += node.comparators
    return any(
        isinstance(each, (ast.Tuple, ast.List)) and ast.unparse(each).strip("()[]") == "1, 2" for each in through
    )


def numbers_a_palm(text: str) -> bool:
    return NAMES_A_PALM.search(UNIT.sub(" ", text.replace("_", " "))) is not None


def names_a_palm(text: str) -> bool:
    """Of a file's source: in code, not in docstrings and comments."""
    if not (numbers_a_palm(text) or "1, 2" in text):
        return False
    tree = ast.parse(text)
    return any(map(numbers_a_palm, said(tree))) or counts_palms(tree)


def test_a_file_that_names_a_palm_by_number_is_told_from_one_that_does_not():
    told = (
        "phi1 = 0",
        "x.s2_m",
        "f(pad1=3)",
        "x = 'palm 2 is up'",
        "for i in (1, 2): pass",
        "a in (1, 2)",
        "def f(theta1): 0",
    )
    others = (
        "a_m_s2 = 0",
        "x = 'of 2 palms, in m/s2'",
        "x = 'stateDiagram-v2'",
        "'''phi1'''",
        "DASHES = (0, (1, 2))",
        "r20 = 1",
    )
    assert all(map(names_a_palm, told))
    assert not any(map(names_a_palm, others))


def test_few_files_name_a_palm_by_number():
    naming = [str(path) for path, text in sources() if names_a_palm(text)]
    assert len(naming) <= MOST_NAMING_A_PALM, (
        f"{len(naming)} files name palm 1 or 2; ask system.mechanism for PALMS, JOINTS, RADII, …: {', '.join(naming)}"
    )


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
